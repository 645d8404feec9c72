"""Many sessions measured as `verify run` measures one: found, shared out, kept, put in tables.

A session is a folder that holds session.toml, on a disk or behind a URL. What has been measured is
kept in OUT at once; started again, a batch does only what is missing or has changed.
"""
