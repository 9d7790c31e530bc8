"""Keywords and options of input files of Abaqus and CalculiX: those that are used, and those without effect on a job.

A keyword or an option that is in neither table is listed as not used, so that none passes without a word. Some options
change what their lines mean, and are refused. Sources: *Abaqus Keywords Guide*; Dhondt, *CalculiX CrunchiX User's
Manual*.
"""

from collections.abc import Iterable, Iterator, Mapping

_POTENTIALS = (
    *("NEO HOOKE", "MOONEY-RIVLIN", "YEOH", "REDUCED POLYNOMIAL", "POLYNOMIAL", "OGDEN", "ARRUDA-BOYCE"),
    *("VAN DER WAALS", "HENCKY", "VALANIS-LANDEL", "USER", "MARLOW", "TEST DATA INPUT"),
)
_SECTION = ("ELSET", "MATERIAL", "ORIENTATION", "COMPOSITE")
_SHELL = (*_SECTION, "OFFSET", "NODAL THICKNESS", "SYMMETRIC", "SHELL THICKNESS", "LAYUP")
_LOAD = ("OP", "AMPLITUDE", "TIME DELAY")
USED: Mapping[str, tuple[str, ...]] = {
    "AMPLITUDE": ("NAME", "VALUE", "TIME", "DEFINITION", "SHIFTX", "SHIFTY", "INPUT"),
    "ANISOTROPIC HYPERELASTIC": ("HOLZAPFEL", "LOCAL DIRECTIONS", "FUNG-ANISOTROPIC", "FUNG-ORTHOTROPIC", "USER"),
    "BOUNDARY": (*_LOAD, "TYPE", "FIXED", "USER", "SUBMODEL"),
    "CLOAD": _LOAD,
    "COUPLING": ("REF NODE", "SURFACE", "ORIENTATION"),
    "DENSITY": (),
    "DISTRIBUTING": (),
    "DLOAD": _LOAD,
    "DSLOAD": _LOAD,
    "ELASTIC": ("TYPE",),
    "ELEMENT": ("TYPE", "ELSET", "INPUT"),
    "ELSET": ("ELSET", "GENERATE", "INSTANCE"),
    "END INSTANCE": (),
    "END PART": (),
    "HYPERELASTIC": ("N", *_POTENTIALS),
    "INCLUDE": ("INPUT",),
    "INSTANCE": ("NAME", "PART"),
    "KINEMATIC": (),
    "MATERIAL": ("NAME",),
    "MEMBRANE SECTION": _SHELL,
    "NODAL THICKNESS": (),
    "NODE": ("NSET", "SYSTEM", "INPUT"),
    "NSET": ("NSET", "ELSET", "GENERATE", "INSTANCE"),
    "ORIENTATION": ("NAME", "SYSTEM", "DEFINITION", "LOCAL DIRECTIONS"),
    "PART": ("NAME",),
    "RIGID BODY": ("NSET", "TIE NSET", "PIN NSET", "REF NODE", "ROT NODE", "ELSET"),
    "SHELL GENERAL SECTION": _SHELL,
    "SHELL SECTION": _SHELL,
    "SOLID SECTION": _SECTION,
    "STATIC": (),
    "STEP": ("NLGEOM", "PERTURBATION"),
    "SURFACE": ("NAME", "TYPE"),
    "TRANSFORM": ("NSET", "TYPE"),
}
"""options that are read, by keyword"""
_COMMENTS = ("NAME", "INTERNAL")
WITHOUT_EFFECT: Mapping[str, tuple[str, ...]] = {
    "ANISOTROPIC HYPERELASTIC": ("MODULI",),  # instantaneous or long-term: the same without *VISCOELASTIC
    "ASSEMBLY": _COMMENTS,
    "BOUNDARY": (),
    "COUPLING": ("CONSTRAINT NAME", *_COMMENTS),
    "ELSET": ("UNSORTED", *_COMMENTS),
    "END ASSEMBLY": (),
    "END STEP": (),
    "HEADING": ("UNSORTED",),
    "HYPERELASTIC": ("MODULI",),
    "NSET": ("UNSORTED", *_COMMENTS),
    "ORIENTATION": _COMMENTS,
    "PREPRINT": ("ECHO", "MODEL", "HISTORY", "CONTACT", "PARSUBSTITUTION", "PARVALUES", "MASSPROP"),
    "MONITOR": ("DOF", "NODE", "FREQUENCY", "PRINT"),
    "NO ANALYSIS": (),
    "OUTPUT": ("FIELD", "HISTORY", "VARIABLE", "FREQUENCY", "FREQ", "NUMBER INTERVAL", "TIME INTERVAL", "TIME POINTS"),
    "PRINT": ("CONTACT", "FREQUENCY", "RESIDUAL", "SOLVE", "ADAPTIVE", "MODEL CHANGE", "PLASTICITY"),
    "RESTART": ("WRITE", "FREQUENCY", "OVERLAY", "NUMBER INTERVAL", "TIME MARKS"),
    "SHELL SECTION": ("SECTION INTEGRATION", "INTEGRATION", "CONTROLS"),
    "SOLID SECTION": ("CONTROLS",),
    "STATIC": ("SOLVER", "DIRECT"),  # how it is solved
    "STEP": ("NAME", "INC", "INCF", "AMPLITUDE", "EXTRAPOLATION", "UNSYMM", "SOLVER"),  # it ends with its loads
    "SURFACE": ("INTERNAL",),
    "TIME POINTS": (*_COMMENTS, "GENERATE"),
}
"""options and keywords that change neither body nor loads of a job, such as requests of output"""
_OUTPUT = (" PRINT", " FILE", " OUTPUT")
_REFUSED: Mapping[tuple[str, str], str] = {
    ("INSTANCE", "INSTANCE"): "Save the mesh of the instance, not a reference to another analysis.",
    ("INSTANCE", "LIBRARY"): "Save the mesh of the instance, not a reference to another analysis.",
    ("NSET", "BINODE"): "List the nodes of the set.",
    ("ELEMENT", "OFFSET"): "Write the numbers of the elements and their nodes as they are.",
    ("ELEMENT", "SOLID ELEMENT NUMBERING"): "Number the nodes of the elements as Abaqus does.",
    ("SURFACE", "COMBINE"): "List the faces of the surface.",
    ("SURFACE", "CROP"): "List the faces of the surface.",
}
"""options without which what remains is another body, with their remedies"""


def _without_blanks(name: str) -> str:
    return name.replace(" ", "").upper()


_KNOWN = {name: {*USED.get(name, ()), *WITHOUT_EFFECT.get(name, ())} for name in {*USED, *WITHOUT_EFFECT}}
_SPELLED = {
    _without_blanks(name): name for name in (*_KNOWN, *(option for known in _KNOWN.values() for option in known))
}


def spelled(name: str) -> str:
    """Return a keyword or an option as the tables spell it: blanks and case do not count."""
    return _SPELLED.get(_without_blanks(name), " ".join(name.upper().split()))


def is_option(keyword: str, text: str) -> bool:
    """Return whether an entry is an option of a keyword, as on a line that continues one which ends in a comma."""
    name, is_assigned, _ = text.partition("=")
    if is_assigned:
        return name.strip()[:1].isalpha()
    return spelled(name) in _KNOWN.get(spelled(keyword), ())


def is_output(keyword: str) -> bool:
    """Return whether a keyword requests output."""
    return keyword.endswith(_OUTPUT)


def not_used(keyword: str, options: Iterable[str]) -> Iterator[str]:
    """Yield what is listed as not used of a keyword: itself, or its options that are not read."""
    if is_output(keyword):
        return
    if keyword not in _KNOWN:
        yield f"*{keyword}"
        return
    yield from (f"*{keyword}, {option}" for option in options if option not in _KNOWN[keyword])


def remedy(keyword: str, options: Iterable[str]) -> tuple[str, str] | None:
    """Return an option that is refused, and what to do; ``None`` if none is."""
    return next(((option, _REFUSED[keyword, option]) for option in options if (keyword, option) in _REFUSED), None)
