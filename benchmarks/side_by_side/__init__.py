"""miniloop and others on the same frames: `run` measures each program in a process of its own, and writes BENCHMARK.md.

The programs take `SEQ OUT`: `python -m benchmarks.side_by_side.miniloop_run SEQ OUT` leaves OUT.json and OUT.txt.
"""
