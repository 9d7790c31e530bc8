"""The state of a body as a value."""

from __future__ import annotations

from dataclasses import dataclass

from dolfinx.fem import Function

from hpcinv.job.job import Job
from hpcinv.mesh.source import Floats
from hpcinv.model.contact_reports import ContactReport


@dataclass(frozen=True, kw_only=True)
class State:
    """State of a body: where its mesh lies, its displacement and pressure, and the numbers of its job. All in SI.

    Attributes:
        job: the job, or the job of this state by itself; it has the numbers of laws, effects and supports.
        mesh_nodes: coordinates of the local geometry nodes of the mesh, (n, 3) in m.
        displacement: ``x - X`` in m.
        pressure: pressure of the mixed form in Pa, else ``None``.
        load: load factor at which it is a solution; 1 is the full load.
        given_displacement: displacement (m) of the given state; on its current body fibres, fields and densities may
            be given; ``None`` if this state is the given one.
        contacts: contacts of the job in its order, with their pressures; none if they are not known.
    """

    job: Job
    mesh_nodes: Floats
    displacement: Function
    pressure: Function | None
    load: float = 1.0
    given_displacement: Function | None = None
    contacts: tuple[ContactReport, ...] = ()

    @property
    def fields(self) -> tuple[Function, Function | None]:
        """Displacement (m) and pressure (Pa)."""
        return self.displacement, self.pressure

    @property
    def is_on_given_mesh(self) -> bool:
        """True if the equations are on the given mesh, not on the shape that an earlier solve found."""
        return self.given_displacement is None

    def moved_to(self, nodes: Floats) -> State:
        """Return the state with the same fields on the mesh at other nodes (m)."""
        return State(
            job=self.job,
            mesh_nodes=nodes,
            displacement=self.displacement,
            pressure=self.pressure,
            load=self.load,
            given_displacement=self.given_displacement,
            contacts=self.contacts,
        )
