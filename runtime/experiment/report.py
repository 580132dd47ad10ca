"""A study's findings where people read them: on the terminal, as Markdown, as CSV, as PNG and SVG."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator
from pathlib import Path

from rich.console import Console
from rich.measure import Measurement
from rich.table import Table as RichTable

from runtime.errors import InputError
from runtime.experiment.estimates import Estimate
from runtime.experiment.palette import style
from runtime.experiment.study import Choices, Findings, Picture, Study, Table, Value

_WIDEST = 1000  # [characters] no table is wider


def show(findings: Findings, console: Console) -> None:
    """Print tables, verdict and assumptions."""
    for table in findings.tables:
        if not table.shown:
            continue
        drawn = RichTable(title=table.title, title_justify="left", box=None, pad_edge=False, title_style="bold")
        for column, cells in zip(table.columns, _columns(table), strict=True):
            drawn.add_column(column, justify="right" if _is_numeric(cells) else "left", overflow="fold")
        for row in table.rows:
            drawn.add_row(*(text(value) for value in row))
        needed = Measurement.get(console, console.options.update(width=_WIDEST), drawn).maximum
        wide = Console(file=console.file, width=max(console.width, needed))  # rather than fold cells
        wide.print(drawn)
        wide.print()
    for sentence in findings.verdict:
        console.print(f"- {sentence}", markup=False, highlight=False, soft_wrap=True)


def write(study: Study, chosen: Choices, findings: Findings, folder: Path) -> list[Path]:
    """Write NAME.csv, NAME.md and the figures; returns what was written. Raises InputError where it cannot."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        written = [_write_csv(table, folder / f"{_stem(study, table.key)}.csv") for table in findings.tables]
        for picture in findings.figures:
            written += _draw(picture, folder, _stem(study, picture.key))
        page = folder / f"{study.name}.md"
        page.write_text("\n".join(_markdown(study, chosen, findings)) + "\n", encoding="utf-8")
    except OSError as error:
        raise InputError(f"findings cannot be written to {folder}: {error.strerror}; choose --out DIR") from None
    return [*written, page]


def text(value: Value) -> str:
    """A cell where people read it: three significant digits, none lost before the point."""
    if value is None:
        return ""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if not isinstance(value, float):
        return str(value)
    if not math.isfinite(value):
        return "-"
    if value == 0 or 1e-3 <= abs(value) < 1e6:
        digits = 0 if value == 0 else max(0, 2 - math.floor(math.log10(abs(value))))
        return f"{value:.{digits}f}"
    return f"{value:.2e}"


def _stem(study: Study, key: str) -> str:
    return f"{study.name}-{key}" if key else study.name


def _columns(table: Table) -> list[list[Value]]:
    return [[row[index] for row in table.rows] for index in range(len(table.columns))]


def _is_numeric(cells: list[Value]) -> bool:
    return any(cell is not None for cell in cells) and not any(isinstance(cell, str | bool) for cell in cells)


def _write_csv(table: Table, path: Path) -> Path:
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        estimated = [any(isinstance(cell, Estimate) for cell in cells) for cells in _columns(table)]
        pairs = zip(table.columns, estimated, strict=True)
        writer.writerow([name for column, two in pairs for name in ([column, f"{column}_se"] if two else [column])])
        for row in table.rows:
            cells = zip(row, estimated, strict=True)
            writer.writerow([item for value, two in cells for item in _csv_cells(value, two)])
    return path


def _csv_cells(value: Value, two: bool) -> list[str]:
    if isinstance(value, Estimate):
        return [repr(float(value.value)), repr(float(value.error))]
    plain = "" if value is None else repr(float(value)) if isinstance(value, float) else str(value)
    return [plain, ""] if two else [plain]


def _markdown(study: Study, chosen: Choices, findings: Findings) -> Iterator[str]:
    yield f"# {study.name}: {study.summary}"
    yield ""
    yield f"`palpate experiment {study.name}` with {_said(chosen)}."
    if findings.verdict:
        yield "\n## Verdict\n"
        yield from (f"- {sentence}" for sentence in findings.verdict)
    for table in findings.tables:
        if table.shown:
            yield f"\n## {table.title}\n"
            yield _line(table.columns)
            yield _line(["---:" if _is_numeric(cells) else "---" for cells in _columns(table)])
            yield from (_line([text(value) for value in row]) for row in table.rows)
    for picture in findings.figures:
        yield f"\n![{picture.caption}]({_stem(study, picture.key)}.png)"
        yield f"\n*{picture.caption}*"
    if findings.assumptions:
        yield "\n## What the paper leaves out\n"
        yield _line(("parameter", "value", "how it was matched or chosen"))
        yield _line(("---", "---", "---"))
        yield from (_line((item.what, item.value, item.why)) for item in findings.assumptions)


def _line(cells: tuple[str, ...] | list[str]) -> str:
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


def _said(chosen: Choices) -> str:
    parts = []
    if chosen.seeds:
        parts.append(f"{chosen.seeds} seeds")
    if chosen.boards:
        parts.append(f"{chosen.boards} boards each")
    if chosen.physics is not None:
        parts.append("the full physics" if chosen.physics else "the statistical model")
    for kind, names in (
        ("strategies", chosen.strategies),
        ("worlds", chosen.worlds),
        ("components", chosen.components),
    ):
        if names:
            parts.append(f"{kind} {', '.join(names)}")
    return "; ".join(parts) or "nothing to choose"


def _draw(picture: Picture, folder: Path, stem: str) -> list[Path]:
    import matplotlib as mpl
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    paths = [folder / f"{stem}.png", folder / f"{stem}.svg"]
    with mpl.rc_context(style(stem)):
        figure = Figure(figsize=picture.size, layout="constrained")
        FigureCanvasAgg(figure)
        picture.draw(figure)
        figure.savefig(paths[0], dpi=150, metadata={"Software": None})
        figure.savefig(paths[1], metadata={"Date": None})
    return paths
