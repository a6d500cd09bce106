"""What a package does not need is left out of its unit: loops over nothing, unreached functions, unread variables."""
