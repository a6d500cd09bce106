"""Compile, load and run C packages; knows neither CasADi nor jinja2."""
