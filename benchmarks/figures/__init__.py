"""Every measured figure stands once, in benchmarks/results.json; README, docs and BENCHMARK.md take it from there."""
