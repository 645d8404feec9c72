"""Documents as HTML and PDF, charts as plotly and matplotlib."""
