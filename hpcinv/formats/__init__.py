"""Files of other programs: one file for each mesh format, which registers itself; writers, and material cards.

The core imports none of them by name: `hpcinv.base.mesh_formats` looks for what is in this folder.
"""

import hpcinv.base.mesh_formats  # noqa: F401  (registers all formats, whichever is imported first)
