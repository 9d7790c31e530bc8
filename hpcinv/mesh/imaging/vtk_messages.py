"""Silence of VTK's readers, which print their errors; what is wrong is told by an exception."""

from __future__ import annotations

import contextlib
import warnings
from collections.abc import Iterator

import vtk


@contextlib.contextmanager
def without_messages_of_vtk() -> Iterator[None]:
    """Context in which VTK prints nothing."""
    before = vtk.vtkObject.GetGlobalWarningDisplay()
    vtk.vtkObject.GlobalWarningDisplayOff()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        vtk.vtkObject.SetGlobalWarningDisplay(before)
