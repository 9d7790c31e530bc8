"""Files of other programs: one file for each mesh format, which registers itself; readers, and material cards.

The core imports none of them by name: `hpcinv.base.mesh_formats` looks for what is in this folder.
"""
