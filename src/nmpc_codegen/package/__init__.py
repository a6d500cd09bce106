"""All rooms share these values: the content of a package, the layout of its memory, the text of its files.

Nothing here needs CasADi, jinja2 or a compiler, and nothing here imports another room.
"""
