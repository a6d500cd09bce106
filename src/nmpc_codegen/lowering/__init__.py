"""CompleteProblem and Choices -> text: linearise, determine every size and name, render."""
