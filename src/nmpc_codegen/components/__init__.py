"""ADD A VARIANT HERE: one folder per seam, one file per variant; base.py defines the contracts."""
