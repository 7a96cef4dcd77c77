"""Making a robot folder from any URDF: shapes in place of meshes, and a proposed description."""
