"""Points followed through whole recordings."""
