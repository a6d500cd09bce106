"""What is to be solved: what the user states, checked, classified and frozen."""
