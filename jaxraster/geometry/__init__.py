"""Triangles before any camera sees them: shapes, normals, intersections."""
