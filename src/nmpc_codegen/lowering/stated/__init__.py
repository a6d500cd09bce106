"""What a package has beside its components: sizes, tables, members, entry points, one file per owner."""
