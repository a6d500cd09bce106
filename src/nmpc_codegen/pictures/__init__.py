"""Pictures of logs, flights, campaigns, plans and solutions are drawn with matplotlib; notebooks show tables.

Lower rooms import this one only inside functions that draw, because matplotlib is an extra.
"""
