"""What a package knows from the start: constant arrays."""
