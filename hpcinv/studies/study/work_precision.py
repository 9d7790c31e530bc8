"""Work–precision diagrams: error against time, a line for each series, the Pareto front behind them."""

from collections.abc import Mapping, Sequence

from matplotlib.axes import Axes
from matplotlib.ticker import LogLocator, NullFormatter

from hpcinv.pages.pictures.figures import as_files, new_figure, style
from hpcinv.studies.batch.diagram_drawing import DiagramSeries, Scale, draw_lines
from hpcinv.studies.study.findings import Accuracy, StepStatistics
from hpcinv.studies.study.result_rows import StudyRow
from hpcinv.studies.study.study_spec import Study


def work_precision(study: Study, accuracy: Accuracy, seconds: str, varied: Mapping[str, str]) -> dict[str, bytes]:
    """Return the diagram of error against time as files by format; none if there is no error to show.

    If the time includes the certificate, its estimated errors are shown next to the true ones.

    Args:
        varied: text on the parameters that vary along each series.
    """
    points = [point for point in accuracy.points if _is_shown(point)]
    if not points:
        return {}
    with new_figure(7.0, 4.8) as figure:
        axes = figure.add_subplot()
        _draw_front(axes, [point for point in points if point.is_on_front])
        for i, series in enumerate(dict.fromkeys(point.series for point in accuracy.points)):
            name = f"{series} ({varied[series]})" if varied[series] else series
            if points_of_series := [point for point in points if point.series == series]:
                _draw_series(axes, i, name, points_of_series)
                if study.time == "certified":
                    _draw_estimates(axes, i, points_of_series)
        many = "average " if any(len(point.errors) > 1 for point in points) else ""
        axes.set(xscale="log", yscale="log", xlabel=f"time / s ({seconds})", ylabel=many + _error_label(accuracy))
        axes.set_title(f"{study.study}: {accuracy.name}")
        axes.xaxis.set_major_formatter("{x:g}")
        axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axes.xaxis.set_minor_formatter(NullFormatter())
        axes.margins(0.08, 0.1)
        axes.legend()
        dotted = "; dotted: as estimated by the certificate" if study.time == "certified" else ""
        axes.annotate(
            f"reference: {_origin(accuracy)}; filled: on the Pareto front{dotted}{_note_on_hidden(accuracy)}",
            (0, -0.16),
            xycoords="axes fraction",
            fontsize=7,
            color="0.35",
            va="top",
        )
        return as_files(figure)


def _note_on_hidden(accuracy: Accuracy) -> str:
    hidden = sum(len(point.errors) > 0 and not _is_shown(point) for point in accuracy.points)
    return f"; {hidden} without any error cannot be shown" if hidden else ""


def _series_against(key: str, rows: Sequence[tuple[StudyRow, float]]) -> list[DiagramSeries]:
    """Return errors of rows against a parameter of the cases, by series and step."""
    points: dict[tuple[str, int, str], list[tuple[float, float]]] = {}
    for row, error in rows:
        if (value := row.place.parameters.get(key)) is not None:
            points.setdefault((row.place.series, row.place.step, row.place.label), []).append((value, error))
    series = []
    for colour, ((name, _, label), own) in enumerate(points.items()):
        title = ", ".join(filter(None, (name, label)))
        places, errors = [(x,) for x, _ in own], [error for _, error in own]
        series.append(DiagramSeries(title, colour, places, errors, ["converged"] * len(own), is_curve=False))
    return series


def case_diagrams(title: str, accuracy: Accuracy, rows: Sequence[StudyRow]) -> dict[str, bytes]:
    """Return diagrams of error against each numeric parameter of the cases as files by format; none without cases."""
    shown = [(row, error) for row, error in zip(rows, accuracy.errors, strict=True) if error]
    keys = dict.fromkeys(key for row in rows for key, v in row.place.parameters.items() if isinstance(v, int | float))
    keys = {key: None for key in keys if len({row.place.parameters.get(key) for row, _ in shown}) > 2}
    if not keys:
        return {}
    with new_figure(3.6 * len(keys) + 1.0, 3.8) as figure:
        every = figure.subplots(1, len(keys), squeeze=False, sharey=True)[0]
        for key, axes in zip(keys, every, strict=True):
            series = _series_against(key, shown)
            positive = all(x > 0 for entry in series for (x,) in entry.places)
            x, y = Scale(key.rpartition(".")[2], positive), Scale(_error_label(accuracy), is_log=True)
            draw_lines(axes, f"{title}: {accuracy.name}" if axes is every[0] else "", series, x, y)
        figure.axes[-1].legend()
        return as_files(figure)


def _is_shown(point: StepStatistics) -> bool:
    return bool(point.average) and bool(point.time)


def _draw_series(axes: Axes, number: int, name: str, points: Sequence[StepStatistics]) -> None:
    colour, marker, dashes = style(number)
    times = [point.time or 0.0 for point in points]
    errors = [point.average or 0.0 for point in points]
    axes.plot(times, errors, linestyle=dashes, color=colour, linewidth=1.2, gid=f"series-{number}")
    for point, time, error in zip(points, times, errors, strict=True):
        face = colour if point.is_on_front else "white"
        axes.plot(time, error, marker, color=colour, markerfacecolor=face, markersize=6)
        if len(point.errors) > 1:
            axes.vlines(time, min(e for e in point.errors if e), max(point.errors), color=colour, linewidth=0.7)
        axes.annotate(
            point.label,
            (time, error),
            xytext=(5, 4 if number % 2 == 0 else -10),
            textcoords="offset points",
            fontsize=7,
            color=colour,
        )
    axes.plot([], [], linestyle=dashes, marker=marker, color=colour, linewidth=1.2, label=name)


def _draw_estimates(axes: Axes, number: int, points: Sequence[StepStatistics]) -> None:
    shown = [(point.time or 0.0, point.promised) for point in points if point.promised]
    colour, _, _ = style(number)
    axes.plot(*zip(*shown, strict=True), linestyle=":", color=colour, linewidth=1.0, gid=f"estimates-{number}")


def _draw_front(axes: Axes, points: Sequence[StepStatistics]) -> None:
    """Draw the smallest error that is reached within a time, which decreases in steps."""
    if not points:  # a run without any error, which cannot be shown, is better than all others
        return
    corners = sorted((point.time or 0.0, point.average or 0.0) for point in points)
    x, y = zip(*corners, strict=True)
    axes.step(
        x,
        y,
        where="post",
        color="0.85",
        linewidth=5,
        zorder=0,
        solid_capstyle="round",
        label="Pareto front",
        gid="front",
    )


def _error_label(accuracy: Accuracy) -> str:
    what = accuracy.name if accuracy.name.startswith("errors.") else f"error of {accuracy.name}"
    return f"{what} / {accuracy.unit}" if accuracy.unit else what


def _origin(accuracy: Accuracy) -> str:
    reference = accuracy.references[0]
    if isinstance(reference, str):
        return "none"
    if len(accuracy.references) > 1:
        return reference.origin.partition(":")[0] + " of each case" if reference.key else reference.origin
    return f"{reference.origin}, {reference.value:.9g} {accuracy.unit}".rstrip()
