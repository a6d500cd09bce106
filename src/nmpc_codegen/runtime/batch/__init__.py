"""Many controllers at once: their memory, their calls on all cores, closed loops in compiled code."""
