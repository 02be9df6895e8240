"""Reads exports with Blender (`pip install bpy`) and prints what Blender has then: python blender.py FILE [CAMERA.json PICTURE.png]"""

import json
import sys
from pathlib import Path

import bpy
import numpy as np


def load(path: Path) -> "bpy.types.Object":
    bpy.ops.wm.read_factory_settings(use_empty=True)
    if path.suffix == ".ply":
        bpy.ops.wm.ply_import(filepath=str(path))
    elif path.suffix == ".obj":
        bpy.ops.wm.obj_import(filepath=str(path), forward_axis="Y", up_axis="Z")
    else:
        bpy.ops.import_scene.gltf(filepath=str(path))
    return next(thing for thing in bpy.data.objects if thing.type == "MESH")


def values(thing: "bpy.types.Object") -> dict:
    mesh, world = thing.data, np.array(thing.matrix_world)
    points = np.array([vertex.co for vertex in mesh.vertices])
    corner = np.empty(len(mesh.vertices), np.int64)
    corner[[loop.vertex_index for loop in mesh.loops]] = np.arange(len(mesh.loops))
    normals = np.array([mesh.corner_normals[i].vector for i in corner]) if mesh.loops else None
    out = {"points": points @ world[:3, :3].T + world[:3, 3], "normals": normals if normals is None else normals @ world[:3, :3].T}
    if mesh.color_attributes:
        attribute = mesh.color_attributes[0]
        places = np.arange(len(points)) if attribute.domain == "POINT" else corner
        out["colours"] = np.array([attribute.data[int(i)].color_srgb[:3] for i in places])
    materials = [node for material in mesh.materials for node in material.node_tree.nodes]
    out["material"] = {
        **{node.image.name: node.image.colorspace_settings.name for node in materials if node.type == "TEX_IMAGE"},
        **{
            name: node.inputs[name].default_value
            for node in materials
            if node.type == "BSDF_PRINCIPLED"
            for name in ("Metallic", "Roughness")
        },
    }
    return out


def show_colours(thing: "bpy.types.Object") -> None:
    """The surface shines with its vertex colours or its texture, without any light, so that a picture shows the colours alone."""
    material = bpy.data.materials.new("colours")
    material.use_nodes = True
    nodes, links = material.node_tree.nodes, material.node_tree.links
    nodes.clear()
    shine, end = nodes.new("ShaderNodeEmission"), nodes.new("ShaderNodeOutputMaterial")
    if thing.data.color_attributes:
        source = nodes.new("ShaderNodeVertexColor")
        source.layer_name = thing.data.color_attributes[0].name
    else:
        source = nodes.new("ShaderNodeTexImage")
        source.image = next(image for image in bpy.data.images if image.size[0])
    links.new(source.outputs["Color"], shine.inputs["Color"])
    links.new(shine.outputs[0], end.inputs["Surface"])
    thing.data.materials.clear()
    thing.data.materials.append(material)


def render(camera: dict, picture: Path) -> None:
    scene = bpy.context.scene
    lens = bpy.data.cameras.new("camera")
    lens.sensor_fit, lens.sensor_width = "HORIZONTAL", 36.0
    lens.lens = camera["fx"] * 36.0 / camera["width"]
    lens.shift_x = -(camera["cx"] + 0.5 - camera["width"] / 2) / camera["width"]
    lens.shift_y = (camera["cy"] + 0.5 - camera["height"] / 2) / camera["width"]
    lens.clip_start = 0.01
    eye = bpy.data.objects.new("camera", lens)
    T = np.array(camera["T_ec"]) @ np.diag([1, -1, -1, 1])
    eye.matrix_world = [list(column) for column in T.T]
    scene.collection.objects.link(eye)
    scene.camera = eye
    scene.render.engine, scene.cycles.samples, scene.cycles.device = "CYCLES", 8, "CPU"
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = camera["width"], camera["height"], 100
    scene.view_settings.view_transform = "Standard"  # the colours as they are; Blender's own default, AgX, is a film's
    scene.render.film_transparent = True
    scene.render.image_settings.file_format, scene.render.image_settings.color_mode = "PNG", "RGBA"
    scene.render.filepath = str(picture)
    bpy.ops.render.render(write_still=True)


def main() -> None:
    thing = load(Path(sys.argv[1]))
    found = {name: value.tolist() if isinstance(value, np.ndarray) else value for name, value in values(thing).items()}
    if len(sys.argv) > 2:
        show_colours(thing)
        render(json.loads(Path(sys.argv[2]).read_text()), Path(sys.argv[3]))
    print("\n" + json.dumps({"program": f"Blender {bpy.app.version_string}", **found}))


main()
