"""Lowering turns a CompleteProblem and Choices into text: linearise, determine every size and name, render."""
