"""The runtime compiles, loads and runs C packages; it needs neither CasADi nor jinja2."""
