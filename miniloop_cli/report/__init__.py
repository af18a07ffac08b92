"""The report of a run, for people."""

from miniloop_cli.report.page import write_report

__all__ = ["write_report"]
