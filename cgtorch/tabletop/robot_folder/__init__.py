"""A robot folder from any URDF: shapes in place of meshes, and a description that is proposed."""
