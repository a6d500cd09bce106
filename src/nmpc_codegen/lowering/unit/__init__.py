"""The translation unit as a tuple of items: read, assembled, passed through the pipeline, printed."""
