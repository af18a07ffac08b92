"""The solvers for cycles of 6 and 7 scans."""
