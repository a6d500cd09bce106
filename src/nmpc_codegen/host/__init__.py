"""The unit that build() compiles for this machine: several shooting nodes at once in the lanes of vector registers."""
