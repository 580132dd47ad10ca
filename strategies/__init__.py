"""Search strategies: where to try next. One class a file; entry points of the group `palpate.strategies` name them.

linear, spiral, hybrid, meta: the paper's four. start: where they begin and how far they go; patterns: the geometry of
their points; covers: meta's optimisation. A strategy imports only `runtime` and its neighbours here: no bus, no clock.
"""
