"""ADD A VARIANT HERE: each seam has a folder, each variant a file; base.py defines the contracts."""
