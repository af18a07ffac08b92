"""Measurements of miniloop itself, each a function from options to rows and one from rows to a picture."""
