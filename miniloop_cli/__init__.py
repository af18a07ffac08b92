"""miniloop: poses and one consistent model from RGB-D scans."""

__version__ = "0.1.0"
