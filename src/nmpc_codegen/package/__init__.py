"""The values that all rooms share: what a package contains, how its memory is laid out, the text of its files.

Nothing here needs CasADi, jinja2 or a compiler, and nothing here imports another room: everything stands on it.
"""
