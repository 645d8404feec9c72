"""A fleet over time: which joint of which arm changed, how, since when, and is it getting worse.

Works on the rows of sessions.parquet; every statement is made in the sessions' own uncertainties.
"""
