"""The overlap graph and its cycles."""
