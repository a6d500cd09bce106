"""The translation unit is a tuple of items, which are read, assembled, passed through the pipeline, and printed."""
