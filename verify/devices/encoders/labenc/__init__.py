"""The LABENC encoder board: its line protocol and its reader."""
