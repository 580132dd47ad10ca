"""Experiments: strategies x worlds x seeds -> tables, figures, verdicts."""
