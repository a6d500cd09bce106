"""ADD A VARIANT HERE: one folder per seam, one file per variant; base.py states the contracts."""
