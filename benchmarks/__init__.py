"""What miniloop is measured by beside the paper's experiments; none of it is installed.

`python -m benchmarks`, in the folder of the repository, lists the measurements: miniloop's own in `experiments/`,
and `run`, which writes BENCHMARK.md from programs that each register a recording in a process of their own.
"""
