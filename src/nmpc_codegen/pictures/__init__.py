"""Pictures with matplotlib, films, and what notebooks show: of logs, flights, campaigns, plans and solutions.

No room below imports this one but inside the functions that draw: matplotlib is needed when something is drawn.
"""
