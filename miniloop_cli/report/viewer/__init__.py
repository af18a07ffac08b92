"""The 3D view: what it shows as plain values and packed points, for the page of a report and for a server."""
