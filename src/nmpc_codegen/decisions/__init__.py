"""CompleteProblem and Options -> Choices: what options leave open, from trials and counts, each with its reason."""
