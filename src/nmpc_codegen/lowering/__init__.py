"""Problem and options -> text: linearise, choose components, determine every size and name, render."""
