"""Report of a run as lines of text, from its statistics."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any

from hpcinv.base.quantity.written_units import as_shown
from hpcinv.job.quantity_of_interest import is_of_nodes
from hpcinv.job.vocabulary import REACTIONS
from hpcinv.output.shape_error import shape_error

_ERRORS = {
    "round_trip": "round trip: closes to {max} ({relative:.1g} of the body's length)",
    "expected_shape": "recovered shape: {max} from the expected one ({relative:.1g} of its length)",
    "expected_surface": "recovered surface: up to {max} from the expected one, rms {rms}, 95 % within"
    " {quantile_95}, overlap (Dice) {dice:.3f}",
}
_LENGTHS = ("max", "rms", "quantile_95")  # in _ERRORS
_SHOWN = 0.05  # s; times of checks above it are printed


def report(statistics: Mapping[str, Any]) -> list[str]:
    """Return the report of a run: lines of text on its statistics."""
    symbols = statistics.get("units", {})
    lines = [*_costs(statistics), *_solutions(statistics["solutions"], symbols)]
    if unused := statistics["unused_petsc_options"]:
        lines.append(f"  solver.petsc: nothing asked for {', '.join(unused)}: misspelt, or without effect here")
    lines += _certificate(statistics["certificate"], symbols)
    if (error := shape_error(statistics)) is not None:
        lines.append(f"shape: estimated error {error.text}")
    return [
        *lines,
        *_quantities(statistics, symbols),
        *_sensitivities(statistics["sensitivities"], symbols),
        *_distances(statistics["errors"], symbols),
    ]


def short_report(statistics: Mapping[str, Any], directory: str) -> list[str]:
    """Return the report of a quiet run: lines of the certificate that do not pass, and the outcome."""
    certificate, seconds = statistics["certificate"], statistics["timings"]["total"]
    certificate_lines = _certificate(certificate, statistics.get("units", {}))[1:]
    open_questions = [line for line in certificate_lines if line.lstrip().startswith(("warning", "fail"))]
    where = f"; results in {directory}" if directory else ""
    return [*open_questions, f"{statistics['status']}, certificate {certificate['verdict']}, {seconds:.1f} s{where}"]


def _contact(contact: Mapping[str, Any], symbols: Mapping[str, str]) -> str:
    penetration = f"penetration at most {as_shown(contact['penetration'], 'm', symbols)}"
    if contact["tolerance"]:
        penetration += f" (tolerated: {as_shown(contact['tolerance'], 'm', symbols)})"
    friction = ""
    if rough := contact.get("friction"):
        friction = f" {_number(rough['sliding_area'])} m² slide, {as_shown(rough['energy_lost'], 'J', symbols)} lost;"
    return (
        f"  {contact['effect']} contact on '{contact['region']}': force"
        f" {as_shown(contact['force'], 'N', symbols)}, area {_number(contact['area'])} m², largest pressure"
        f" {as_shown(contact['largest_pressure'], 'Pa', symbols)}, {penetration};{friction}"
        f" {contact['assumption']}"
    )


def _cavity(cavity: Mapping[str, Any], symbols: Mapping[str, str]) -> str:
    pressure = as_shown(cavity["pressure"], "Pa", symbols)
    volume, unloaded = (as_shown(cavity[key], "m^3", symbols) for key in ("volume", "unloaded_volume"))
    return f"  cavity '{cavity['name']}': pressure {pressure}, volume {volume}, unloaded {unloaded}"


def _remote_load(load: Mapping[str, Any], symbols: Mapping[str, str]) -> str:
    motion = load["motion"]
    moved = as_shown(motion["move"], "m", symbols)
    axis = ", ".join(_number(c) for c in motion["axis"])
    turned = f"turned by {math.degrees(motion['rotate']):.5g}° about ({axis})"
    return f"  remote load on '{load['region']}': moved by {moved}, {turned}"


def _costs(statistics: Mapping[str, Any]) -> list[str]:
    """Return lines on the outcome, times and memory."""
    timings, memory = statistics["timings"], statistics["peak_memory"]
    total = sum(solution["factorizations"] for solution in statistics["solutions"])
    slowest = sorted(((p["max"], phase) for phase, p in timings["phases"].items()), reverse=True)
    most = max(memory["phases"], key=lambda phase: memory["phases"][phase]["max"])
    return [
        f"{statistics['status']}, {counted(total, 'factorization')}, {timings['total']:.1f} s",
        "  seconds: " + ", ".join(f"{phase} {seconds:.1f}" for seconds, phase in slowest if seconds >= _SHOWN),
        f"  outside kernels, PETSc and MPI: {100 * timings['overhead']:.0f} %",
        f"  memory: {max(memory['ranks']) / 1e6:.0f} MB on the fullest rank; most in {most}",
    ]


def _solutions(solutions: Sequence[Mapping[str, Any]], symbols: Mapping[str, str]) -> Iterator[str]:
    """Yield lines on each solution, its contacts, and what it found for loads and supports."""
    for solution in solutions:
        title = solution.get("state", solution["direction"])
        if solution["linear"] and solution["linear"]["fallback"]:
            yield f"  {title}: {solution['linear']['fallback']}"
        if coarse := solution.get("coarse"):
            fate = f"not used: {coarse['unused']}" if coarse["unused"] else "the path was followed there"
            effort = f"{coarse['unknowns']} unknowns, {counted(coarse['factorizations'], 'factorization')}"
            yield f"  {title}: on coarser cells {effort}; {fate}"
        yield (
            f"  {title}: J from {_number(solution['J']['min'])} to {_number(solution['J']['max'])}, "
            f"strain energy {_number(solution['strain_energy'])} J"
        )
        yield from (_contact(contact, symbols) for contact in solution["contacts"])
        yield from (_cavity(cavity, symbols) for cavity in solution.get("cavities", ()))
        yield from (_remote_load(load, symbols) for load in solution.get("remote_loads", ()))
        for found in solution.get("constraints", ()):
            yield f"  {found['effect']}: {found['key']} {as_shown(found['value'], found['unit'], symbols)}"


def _quantities(statistics: Mapping[str, Any], symbols: Mapping[str, str]) -> Iterator[str]:
    """Yield a line on each quantity of interest, with its errors."""
    reductions, units = _node_reductions(statistics), statistics.get("quantity_units", {})
    for name, value in statistics["quantities"].items():
        text = partial(as_shown, unit=units.get(name, "m" if isinstance(value, list) else ""), symbols=symbols)
        notes = ", ".join(_errors_of_quantity(statistics, name, text))
        reduction = f", {reductions[name]} of the nodes" if name in reductions else ""
        yield f"{name}: {text(value)}{f' ({notes})' if notes else ''}{reduction}"


def _estimated_error(estimate: Mapping[str, Any], name: str, omission: str, text: Callable[..., str]) -> str:
    singular, layer, more = estimate.get("singular"), estimate.get("layer", {}).get(name), ""
    is_doubted = (singular and not singular["reliable"]) or name in estimate.get("unreliable", ())
    if layer:
        size = f"{text(layer['error'], digits=2)} of its layer" if layer["error"] else "the error of its layer"
        more = f" and {size}, {layer['cause']}"
    doubt = ", not reliable here" if is_doubted else ""
    return f"estimated error {text(estimate['quantities'][name], digits=2)}{more}{omission}{doubt}"


def _errors_of_quantity(statistics: Mapping[str, Any], name: str, text: Callable[..., str]) -> Iterator[str]:
    """Yield notes on the errors of a quantity, whose values ``text`` shows."""
    is_reaction, slopes = name in _reactions(statistics), statistics["sensitivities"]
    if (spread := (statistics.get("surface_errors") or {}).get("quantities", {}).get(name)) is not None:
        yield f"± {text(spread, digits=2)} by errors of the surface"
    yield from (f"{ends} {cause}" for ends, cause in intervals_of(statistics, name, text))
    if error := _error_of_mesh(statistics, name, text, is_reaction=is_reaction):
        yield error
    if slopes is not None and slopes["quantities"].get(name, {"sd": None})["sd"] is not None:
        yield f"standard deviation {text(slopes['quantities'][name]['sd'], digits=2)}"
    elif slopes is not None and is_reaction:
        yield "no sensitivities of reactions"


def intervals_of(statistics: Mapping[str, Any], name: str, text: Callable[..., str]) -> Iterator[tuple[str, str]]:
    """Yield the ends between which a quantity may lie, and over what, from the lines of the certificate."""
    for line in statistics["certificate"]["lines"]:
        interval = line.get("interval") or {}
        if interval.get("of") == name:
            ends = ("no end" if end is None else text(end, digits=4) for end in (interval["low"], interval["high"]))
            yield " to ".join(ends), f"over all {interval['by']}"


def _error_of_mesh(statistics: Mapping[str, Any], name: str, text: Callable[..., str], *, is_reaction: bool) -> str:
    """Return the bound of the error of a quantity, or its estimate; empty if there is neither."""
    estimate = statistics["certificate"]["estimate"]
    bounds = (statistics.get("accuracy") or {"bounds": {}})["bounds"]
    omission = ", without the error of the geometry" if estimate and estimate.get("without_geometry") else ""
    if name in bounds:
        if bounds[name] is None or not math.isfinite(bounds[name]):
            return "error not bounded: one mesh proves nothing here"
        return f"error at most {text(bounds[name], digits=3)}{omission}"
    if estimate and name in estimate["quantities"]:
        return _estimated_error(estimate, name, omission, text)
    return "no error estimate for reactions" if is_reaction and estimate is not None else ""


def _distances(errors: Mapping[str, Any], symbols: Mapping[str, str]) -> Iterator[str]:
    """Yield lines on the distances between solutions, and from an expected shape."""
    for name in ("round_trip", "expected_shape"):
        if sizes := errors.get(name):
            shown = {key: as_shown(sizes[key], "m", symbols, 3) for key in _LENGTHS if key in sizes}
            yield _ERRORS["expected_surface" if "dice" in sizes else name].format(**sizes | shown)


def _certificate(certificate: Mapping[str, Any], symbols: Mapping[str, str]) -> list[str]:
    lines = [f"certificate: {certificate['verdict']}"]
    for line in certificate["lines"]:
        value_text = "" if line["value"] is None else f" {as_shown(line['value'], line['unit'], symbols, 3)}"
        note = f" ({line['note']})" if line["note"] else ""
        seconds = f", {line['seconds']:.1f} s" if (line["seconds"] or 0.0) >= _SHOWN else ""
        state = f"{line['state']}: " if "state" in line else ""
        lines.append(f"  {line['verdict']}: {state}{line['name']}{value_text}{note}{seconds}")
        if text := line.get("remedy"):
            lines.append(f"    {text}")
    return lines


def _sensitivities(sensitivities: Mapping[str, Any] | None, symbols: Mapping[str, str]) -> list[str]:
    """Return lines on the derivatives by each parameter, and on the standard deviation of the shape."""
    if sensitivities is None:
        return []
    assumed = f", if {text}" if (text := sensitivities.get("assumption")) else ""
    lines, shapes = [f"per SI unit of{assumed}"], sensitivities.get("shapes") or {"": sensitivities["shape"]}
    for key in sensitivities["parameters"]:
        slopes = [
            f"{name} {_value(entry['slopes'][key], digits=4)}" for name, entry in sensitivities["quantities"].items()
        ]
        for state, shape in shapes.items():
            slopes.append(f"{_shape(state)} up to {_number(shape['largest'][key], 4)} m")
        lines.append(f"  {key}: {', '.join(slopes)}")
    for state, shape in shapes.items():
        if shape["sd"] is not None:
            most = f"up to {as_shown(shape['sd'], 'm', symbols, 2)}, at {as_shown(shape['sd_at'], 'm', symbols, 4)}"
            lines.append(f"{_shape(state)}: standard deviation {most}")
    return lines


def _shape(state: str) -> str:
    return f"shape '{state}'" if state else "shape"


def _reactions(statistics: Mapping[str, Any]) -> dict[str, str]:
    """Return the units of the quantities that are reactions, by name."""
    sources = {q["name"]: q["of"].strip() for q in statistics.get("job", {}).get("quantities", ())}
    return {name: REACTIONS[source] for name, source in sources.items() if source in REACTIONS}


def _node_reductions(statistics: Mapping[str, Any]) -> dict[str, str]:
    """Return the reductions of the quantities that are means of nodes, by name."""
    job = statistics.get("job", {})
    return {q["name"]: q["reduce"] for q in job.get("quantities", ()) if is_of_nodes(q, job.get("let", {}))}


def _value(value: float | list[float | None] | None, digits: int = 6, unit: str = "m") -> str:
    """Return a number, or a vector with its unit, as text."""
    if isinstance(value, list):
        return f"({', '.join(_number(v, digits) for v in value)}) {unit}"
    return _number(value, digits)


def _number(value: float | None, digits: int = 6) -> str:
    return "not finite" if value is None else f"{value:.{digits}g}"


def counted(number: int, noun: str) -> str:
    """Return a number with a noun, in the plural unless the number is 1."""
    return f"{number} {noun}{'' if number == 1 else 's'}"
