"""The live page: a small server in a process of its own, fed by the run, seen in a browser.

feed.py        in the run's process: pictures and numbers, ten times a second, to the server
server.py      in its own process: pages, web sockets, metrics; viewers cost the run nothing
access.py      who may look
run_source.py, board_source.py  what a run has to show, and the taking of board pictures
grab_source.py  what a grab has; what viewers say comes back through feed.py, as words
"""
