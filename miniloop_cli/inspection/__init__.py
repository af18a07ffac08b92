"""A look at a recording before any run: what it is, what looks wrong, and what to do about it."""
