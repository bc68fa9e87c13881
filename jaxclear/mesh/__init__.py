"""Worn parts as meshes of hexahedra whose inside follows the worn wall: `jaxclear.mesh`."""

from jaxclear.ground.argument_errors import nothing_else
from jaxclear.mesh.block_mesh import BlockMesh
from jaxclear.mesh.solids import Solid
from jaxclear.mesh.worn_part import solid, write

__all__ = ["BlockMesh", "Solid", "solid", "write"]
__getattr__, __dir__ = nothing_else("jaxclear.mesh", __all__)
