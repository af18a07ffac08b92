"""The 3D view: its content as plain values and packed points, for the page of a report and for a server."""
