"""Search strategies: where to try next. One class a file; entry points of the group `palpate.strategies` name them.

linear, spiral, hybrid, meta: the paper's four. start: where they begin and how far they go; patterns: the geometry of
their points; covers: meta's optimisation.

bayes, bayes_slide: beyond the paper. pursuit: one hole pursued with a belief; learning: what earlier searches taught;
offset_grid: what failures leave of a density; guard: the sweep that needs no belief. The hierarchy of errors itself is
`runtime.hierarchy`.

A strategy imports only `runtime` and its neighbours here: no bus, no clock.
"""
