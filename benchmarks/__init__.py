"""What miniloop is measured by beside the paper's experiments; none of it is installed.

`python -m benchmarks`, in the folder of the repository, lists the measurements: those of `experiments/`, which write
rows and a picture as `miniloop bench` does, some that print tables, and `run` of `side_by_side/`, which measures
miniloop beside others and writes BENCHMARK.md.
"""
