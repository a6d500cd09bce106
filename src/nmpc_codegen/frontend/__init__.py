"""The front end checks the user's statements, classifies and freezes them into a Problem, and completes it."""
