"""summary.json: what it counts."""

from miniloop_cli.results.write import pairs_by_solver


def test_every_pair_is_counted_whatever_made_it():
    solvers = ["cycle4", "guided", "pairwise", "cycle4", "planar3", "guided", "cycle7"]
    counts = pairs_by_solver(solvers, 5)
    assert counts == {"5": 0, "4": 2, "3": 0, "pairwise": 1, "cycle7": 1, "guided": 2, "planar3": 1}
    assert list(counts)[:4] == ["5", "4", "3", "pairwise"]
    assert list(pairs_by_solver(solvers, 7))[:3] == ["7", "6", "5"]
