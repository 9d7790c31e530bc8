"""Parts of a body that only contact or sliding holds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.quantity.arrays import Booleans
from hpcinv.errors import MeshError
from hpcinv.job.job import Job
from hpcinv.mesh import Body
from hpcinv.mesh.parts import parts_of
from hpcinv.mesh.source import Floats, Ints
from hpcinv.model.interfaces.facets import Facets, RegionFacets, gathered
from hpcinv.model.interfaces.pair import SurfacePair
from hpcinv.model.interfaces.pins import Pins
from hpcinv.model.supports import Supports
from hpcinv.model.weak_form import WeakForm
from hpcinv.physics.closures import CLOSURES
from hpcinv.solver.support_checks import joined_parts, node_labels


def pins_of(job: Job, body: Body, supports: Supports, weak_form: WeakForm) -> list[Pins]:
    """Return the pins of all parts that only contact or sliding without friction holds; collective.

    Raises:
        MeshError: on all ranks, if a closure leaves such a part without balance or without a place.
    """
    pairs: Sequence[SurfacePair] = weak_form.contacts.pairs
    loose = [pair for pair in pairs if pair.spec.kind != "tied"]
    if not loose or any(effect.holds for effect in job.effects):
        return []
    if weak_form.kinematics.sign < 0 and any(pair.spec.assumed and pair.spec.assumed.searched_from for pair in loose):
        found = pins_of_loose_parts(job, body, supports, weak_form)
        for pins in found:
            pins.follows = True
        return found
    count, labels = joined_parts(body, [i for i in job.interfaces if i.kind == "tied"], *parts_of(body))
    parts = [_pins(label, labels, body, loose, weak_form) for label in _free_parts(body, supports, count, labels)]
    return [pins for pins in parts if pins is not None and pins.count]


def pins_of_loose_parts(job: Job, body: Body, supports: Supports, weak_form: WeakForm) -> list[Pins]:
    """Return pins for all rigid motions that supports leave free, whatever contact holds; collective."""
    pairs: Sequence[SurfacePair] = [pair for pair in weak_form.contacts.pairs if pair.spec.kind != "tied"]
    if any(effect.holds for effect in job.effects):
        return []
    count, labels = joined_parts(body, [i for i in job.interfaces if i.kind == "tied"], *parts_of(body))
    nodes, comm, found = body.given_nodes / body.length_scale, body.mesh.comm, list[Pins]()
    for label in range(count):
        named = [surface for pair in pairs for surface in zip(pair.spec.between, pair.surfaces, strict=True)]
        own = [(name, gathered(_of_part(s, s.at(nodes), labels == label), comm)) for name, s in named]
        names, facets = [name for name, f in own if len(f)], [f for _, f in own if len(f)]
        if not facets:
            continue
        places = np.concatenate([f.points.reshape(-1, 3) for f in facets])
        numbers = np.concatenate([f.unknowns.reshape(-1, 3) for f in facets])
        pins = Pins(names[0], (places, numbers), _held(supports, labels, label, comm), weak_form.unknowns, comm)
        if pins.count:
            found.append(pins)
        else:
            pins.destroy()
    return found


def _held(supports: Supports, labels: Ints, label: int, comm: MPI.Intracomm) -> tuple[Floats, Floats]:
    """Return the directions (n, 3) along which supports hold nodes of a part, and their places, on all ranks."""
    directions, places = [np.zeros((0, 3))], [np.zeros((0, 3))]
    for holder in supports.holders:
        is_there = node_labels(holder.space, labels)[holder.nodes] == label
        directions.append(holder.component_of(np.tile(np.eye(3), (len(holder.nodes), 1, 1)))[is_there])
        places.append(holder.points[is_there])
    own = np.concatenate(directions), np.concatenate(places)
    everywhere = [np.concatenate(comm.allgather(part)) for part in own]
    return everywhere[0], everywhere[1]


def _free_parts(body: Body, supports: Supports, count: int, labels: Ints) -> list[int]:
    held = [node_labels(support.space, labels)[support.nodes] for support in supports.holders]
    everywhere = body.mesh.comm.allgather(np.unique(np.concatenate([np.zeros(0, dtype=np.int64), *held])))
    return sorted(set(range(count)) - set(np.concatenate(everywhere).tolist()))


def _pins(label: int, labels: Ints, body: Body, pairs: Sequence[SurfacePair], weak_form: WeakForm) -> Pins | None:
    """Return the pins of a part; ``None`` if friction that the solve finds holds it."""
    nodes, comm = body.given_nodes / body.length_scale, body.mesh.comm
    region, surfaces, normals = "", list[Facets](), list[tuple[Floats, Floats]]()
    for pair in pairs:
        if _is_within(pair, labels == label, comm):
            continue
        for name, surface in zip(pair.spec.between, pair.surfaces, strict=True):
            own = gathered(_of_part(surface, surface.at(nodes), labels == label), comm)
            if not len(own):
                continue
            if pair.spec.friction and pair.is_iterated:
                return None
            _check_closure(pair, name, weak_form.kinematics.sign)
            region = region or name
            surfaces.append(own)
            normals.append(pair.given_normals)
    if not surfaces:
        return None
    places = np.concatenate([facets.points.reshape(-1, 3) for facets in surfaces])
    numbers = np.concatenate([facets.unknowns.reshape(-1, 3) for facets in surfaces])
    directions, at = (np.concatenate(part) for part in zip(*normals, strict=True))
    return Pins(region, (places, numbers), (directions, at), weak_form.unknowns, comm)


def _is_within(pair: SurfacePair, is_in_part: Booleans, comm: MPI.Intracomm) -> bool:
    """Return whether both surfaces belong to a part, which nothing else holds by them."""
    within = all(is_in_part[surface.cells].all() for surface in pair.surfaces)
    return bool(comm.allreduce(within, op=MPI.LAND))


def _of_part(region: RegionFacets, facets: Facets, is_in_part: Floats) -> Facets:
    chosen = is_in_part[region.cells]
    arrays = (facets.nodes, facets.unknowns, facets.points, facets.signs)
    nodes, unknowns, points, signs = (array[chosen] for array in arrays)
    return replace(facets, nodes=nodes, unknowns=unknowns, points=points, signs=signs)


def _check_closure(pair: SurfacePair, region: str, sign: int) -> None:
    closure = pair.spec.assumed
    if sign < 0 and closure is not None and closure.leaves_open:
        holding = " or ".join(f"'{name}'" for name, kind in CLOSURES.items() if not kind.leaves_open)
        raise MeshError(
            f"{pair.where}.closure: '{closure.name}' {closure.leaves_open}: nothing but contact holds the part with"
            f" '{region}'",
            f"Assume {holding}, or hold the part by supports.",
        )
