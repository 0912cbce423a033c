"""What a scene is written as, for people and for other programs."""

from functools import partial

from edit3r import Component, hookimpl

EDIT3R_API = 1

_gaussforge = partial(Component, requires=("gaussforge",), extra="export")
_DEGREES = "harmonics above degree 3, objects, uncertainty"


@hookimpl
def register_writers() -> list[Component]:
    return [
        Component(
            "viewer",
            "edit3r_outputs.viewer:ViewerWriter",
            "one page to walk through the scene, which opens anywhere",
            suffix=".html",
            stem="viewer",
            keeps="what can be seen, the look before the edit, objects, uncertainty",
            loses="exact numbers: places to 1/60 of a pixel, the rest to 8 bits",
        ),
        Component(
            "video",
            "edit3r_outputs.video:VideoWriter",
            "a flight around the scene",
            suffix=".webm",
            stem="video",
            keeps="what is seen on the way",
            loses="all else",
        ),
        Component(
            "mp4",
            "edit3r_outputs.mp4:Mp4Writer",
            "the flight as H.264, for phones, slides and social media",
            suffix=".mp4",
            stem="video",
            keeps="what is seen on the way",
            loses="all else",
            requires=("av",),
            extra="mp4",
        ),
        Component(
            "sheet",
            "edit3r_outputs.sheet:SheetWriter",
            "photo, 2D edit and 3D result of each view side by side",
            suffix=".png",
            stem="before_after",
            keeps="what the photos' cameras see",
            loses="all else",
        ),
        Component(
            "ply",
            "edit3r_outputs.formats:PlyWriter",
            "the PLY of 3D Gaussian Splatting, for most programs",
            suffix=".ply",
            keeps="every Gaussian, exactly",
            loses="harmonics above degree 3",
        ),
        _gaussforge(
            "spz",
            "edit3r_outputs.formats:SpzWriter",
            "small, for phones and web viewers",
            suffix=".spz",
            keeps="every Gaussian, with harmonics",
            loses=f"exact numbers; {_DEGREES}",
        ),
        _gaussforge(
            "spz4",
            "edit3r_outputs.formats:Spz4Writer",
            "the newer SPZ, which PlayCanvas' engine reads",
            suffix=".v4.spz",
            keeps="every Gaussian, with harmonics",
            loses=f"exact numbers; {_DEGREES}",
        ),
        _gaussforge(
            "sog",
            "edit3r_outputs.formats:SogWriter",
            "smallest, for PlayCanvas and SuperSplat; takes half a minute",
            suffix=".sog",
            keeps="every Gaussian, with harmonics",
            loses=f"exact numbers; {_DEGREES}",
        ),
        _gaussforge(
            "splat",
            "edit3r_outputs.formats:SplatWriter",
            "for older web viewers",
            suffix=".splat",
            keeps="every Gaussian, in one colour from all sides",
            loses="harmonics, objects, uncertainty; turns and opacities to 8 bits",
        ),
        _gaussforge(
            "compressed-ply",
            "edit3r_outputs.formats:CompressedPlyWriter",
            "for SuperSplat and PlayCanvas",
            suffix=".compressed.ply",
            keeps="every Gaussian, with harmonics",
            loses=f"exact numbers; {_DEGREES}",
        ),
        Component(
            "glb",
            "edit3r_outputs.glb:GlbWriter",
            "glTF with the extension for Gaussians, for 3D programs",
            suffix=".glb",
            keeps="every Gaussian, exactly, upright; as points where the extension is unknown",
            loses=_DEGREES,
        ),
        Component(
            "mesh",
            "edit3r_outputs.mesh:MeshWriter",
            "coloured triangles as PLY, for programs that cannot show Gaussians",
            suffix="-mesh.ply",
            keeps="the surfaces that the photos' cameras see, upright, in one colour each",
            loses="what no camera sees, what is transparent, harmonics",
        ),
        Component(
            "colmap",
            "edit3r_outputs.posed_photos:ColmapWriter",
            "the photos' cameras and edited images as COLMAP's model",
            suffix="-colmap",
            keeps="cameras, edited images, centres and colours of up to 100,000 Gaussians",
            loses="shapes and opacities",
        ),
        Component(
            "nerfstudio",
            "edit3r_outputs.posed_photos:NerfstudioWriter",
            "the photos' cameras and edited images as nerfstudio's transforms.json",
            suffix="-nerfstudio",
            keeps="cameras, edited images, centres and colours of up to 100,000 Gaussians",
            loses="shapes and opacities",
        ),
    ]


@hookimpl
def register_commands() -> list[Component]:
    return [
        Component(
            "render",
            "edit3r_outputs.render:RenderCommand",
            "pictures, a video and a viewer page from a saved scene (3DGS PLY)",
        ),
        Component(
            "export",
            "edit3r_outputs.export:ExportCommand",
            "a saved scene by any writer: a page, a video, or a format of other programs",
        ),
    ]
