"""What a run looks like in space: bodies, joints and worn walls as triangles and quadrilaterals."""
