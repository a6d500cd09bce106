"""Compile, load and run C packages, without CasADi and jinja2."""
