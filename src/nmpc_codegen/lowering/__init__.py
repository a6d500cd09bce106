"""Problem and options -> text: linearise, choose, decide every size and name, render."""
