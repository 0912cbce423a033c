"""PLY of points and triangles, for programs that know no Gaussians."""

import numpy as np

_NAMES = {"f4": "float", "u1": "uchar", "i4": "int"}


def coloured_ply(
    positions: np.ndarray, colours: np.ndarray, faces: np.ndarray | None = None
) -> bytes:
    """Binary PLY of vertices: positions `[n, 3]`, colours `[n, 3]` in bytes, and the corners
    `[m, 3]` of triangles if given.
    """
    columns = [(name, "<f4") for name in ("x", "y", "z")]
    columns += [(name, "u1") for name in ("red", "green", "blue")]
    vertices = np.zeros(len(positions), columns)
    for (name, _), column in zip(columns, (*positions.T, *colours.T)):
        vertices[name] = column
    header = [
        "ply",
        "format binary_little_endian 1.0",
        f"element vertex {len(vertices)}",
    ]
    header += [f"property {_NAMES[kind[-2:]]} {name}" for name, kind in columns]
    content = vertices.tobytes()
    if faces is not None:
        triangles = np.zeros(len(faces), [("count", "u1"), ("corners", "<i4", 3)])
        triangles["count"], triangles["corners"] = 3, faces
        header.append(f"element face {len(faces)}")
        header.append("property list uchar int vertex_indices")
        content += triangles.tobytes()
    return "\n".join((*header, "end_header", "")).encode() + content
