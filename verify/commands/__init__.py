"""One module a command; heavy imports wait until it runs, so that --help answers at once."""
