"""Make the seeds of the fuzz targets from the toy packages of tests/model/fixtures.

    python tests/fuzz/make_corpus.py

zip: small archives, stored and deflated. graph: graph and tables of weights, in the layout of
graph_fuzz.cpp. card: the toy cards with short probes. asset: a triangle as GLB, one with a skin, a
morph target, instances and colours, polygons as OBJ, and an MTL. image: small pictures.
The results are committed.
"""

import io
import json
import struct
import zipfile
from pathlib import Path

from PIL import Image

HERE = Path(__file__).parent
FIXTURES = HERE.parent / "model" / "fixtures"
UNREAD = (
    "metadata", "module_call_graph", "treespec_namedtuple_fields", "opset_version", "verifiers",
    "torch_version", "sym_int_values", "sym_bool_values", "script_obj_values", "requires_grad",
    "device", "hint", "is_hop_single_tensor_return", "guards_code",
)  # fmt: skip
TOYS = ("toy_cnn", "toy_norm", "toy_vit")


def compact(value: object) -> bytes:
    """Return JSON without spaces."""
    return json.dumps(value, separators=(",", ":")).encode()


def without(value: object, dropped: tuple[str, ...]) -> object:
    """Remove keys that the reader ignores, so that mutations hit the keys that it reads."""
    if isinstance(value, dict):
        return {k: without(v, dropped) for k, v in value.items() if k not in dropped}
    return [without(v, dropped) for v in value] if isinstance(value, list) else value


def graph_seed(name: str) -> bytes:
    """Return graph, weights and constants of a toy package; weight files are renumbered."""
    texts = []
    with zipfile.ZipFile(FIXTURES / f"{name}.pt2") as archive:
        for entry in ("models/model.json", "data/weights/model_weights_config.json",
                      "data/constants/model_constants_config.json"):  # fmt: skip
            texts.append(without(json.loads(archive.read(f"{name}/{entry}")), UNREAD))
    for i, weight in enumerate(texts[1]["config"].values()):
        weight["path_name"] = f"weight_{i % 10}"
    for constant in texts[2]["config"].values():
        constant["path_name"] = "missing"
    return b"\n=\n".join(compact(text) for text in texts)


def zip_seed(compression: int, entries: dict[str, bytes]) -> bytes:
    """Return a zip archive with a fixed date."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", compression) as archive:
        for name, content in entries.items():
            archive.writestr(zipfile.ZipInfo(name), content, compression)
    return buffer.getvalue()


def zip_seeds() -> dict[str, bytes]:
    """Return small archives of the kinds that the reader distinguishes."""
    good = {
        "m/archive_format": b"pt2", "m/archive_version": b"0", "m/byteorder": b"little",
        "m/models/model.json": b'{"graph_module":{"metadata":[1],"graph":[1.5,"x",null]}}',
        "m/data/weights/weight_0": bytes(range(64)), "m/large": b"abcd" * 64,
    }  # fmt: skip
    return {
        "stored": zip_seed(zipfile.ZIP_STORED, good),
        "deflated": zip_seed(zipfile.ZIP_DEFLATED, good),
        "outside": zip_seed(zipfile.ZIP_STORED, {**good, "m/../x": b"x"}),
        "pickle": zip_seed(zipfile.ZIP_STORED, {"m/data.pkl": b"x", "m/version": b"3"}),
        "bomb": zip_seed(zipfile.ZIP_DEFLATED, {**good, "m/large": bytes(20000)}),
    }


def card_seed(name: str) -> bytes:
    """Return a toy card whose probe is reduced to one case and few numbers."""
    card = json.loads((FIXTURES / f"{name}.json").read_text())
    case = card["probe"]["cases"][0]
    case["gradient"] = case["gradient"][:4]
    card["probe"]["cases"] = [case]
    return compact(card)


def glb(scene: object, binary: bytes) -> bytes:
    """Return a GLB after the byte that selects the reader."""
    text = compact(scene)
    text += b" " * (-len(text) % 4)
    length = 12 + 8 + len(text) + 8 + len(binary)
    head = struct.pack("<4sII", b"glTF", 2, length)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text
    return b"g" + head + chunks + struct.pack("<I4s", len(binary), b"BIN\0") + binary


def glb_seed() -> bytes:
    """Return a coloured triangle with uvs as GLB, after the byte that selects the reader."""
    points = struct.pack("<15f", 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 1)
    binary = points + struct.pack("<3H2x", 0, 1, 2)
    views = [
        {"buffer": 0, "byteOffset": a, "byteLength": n} for a, n in ((0, 36), (36, 24), (60, 6))
    ]
    kinds = ((5126, "VEC3"), (5126, "VEC2"), (5123, "SCALAR"))
    accessors = [
        {"bufferView": i, "componentType": c, "count": 3, "type": t}
        for i, (c, t) in enumerate(kinds)
    ]
    scene = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "scale": [1, 2, 1]}],
        "meshes": [
            {
                "primitives": [
                    {"attributes": {"POSITION": 0, "TEXCOORD_0": 1}, "indices": 2, "material": 0}
                ]
            }
        ],
        "materials": [{"pbrMetallicRoughness": {"baseColorFactor": [1, 0.5, 0, 1]}}],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": len(binary)}],
    }
    return glb(scene, binary)


def rich_glb_seed() -> bytes:
    """Return a triangle with a skin, sparse morph target, instances, colours and extensions."""
    parts = [
        struct.pack("<9f", 0, 0, 0, 1, 0, 0, 0, 1, 0),  # positions, translations
        struct.pack("<12B", *(1, 0, 0, 0) * 3),  # joints, weights
        struct.pack("<9f", 1, 0, 0, 0, 1, 0, 0, 0, 1),  # colours
        struct.pack("<32f", *(1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1) * 2),  # matrices
        struct.pack("<2H3f", 1, 0, 0, 1, 0),  # sparse index and value
        struct.pack("<6H", 0, 1, 1, 0, 1, 1),  # uvs
    ]
    views, binary = [], b""
    for part in parts:
        views.append({"buffer": 0, "byteOffset": len(binary), "byteLength": len(part)})
        binary += part
    kinds = (
        (0, 5126, 3, "VEC3"), (1, 5121, 3, "VEC4"), (2, 5126, 3, "VEC3"), (3, 5126, 2, "MAT4"),
        (5, 5123, 3, "VEC2"),
    )  # fmt: skip
    accessors = [
        {"bufferView": v, "componentType": c, "count": n, "type": t} for v, c, n, t in kinds
    ]
    accessors.append({
        "componentType": 5126, "count": 3, "type": "VEC3",
        "sparse": {"count": 1, "indices": {"bufferView": 4, "componentType": 5123},
                   "values": {"bufferView": 4, "byteOffset": 4}},
    })  # fmt: skip
    primitive = {
        "attributes": {"POSITION": 0, "JOINTS_0": 1, "WEIGHTS_0": 1, "COLOR_0": 2, "TEXCOORD_0": 4},
        "targets": [{"POSITION": 5}],
        "material": 0,
    }
    instances = {"attributes": {"TRANSLATION": 0, "SCALE": 2}}
    scene = {
        "asset": {"version": "2.0"},
        "extensionsRequired": ["KHR_mesh_quantization", "EXT_mesh_gpu_instancing"],
        "nodes": [
            {"mesh": 0, "skin": 0},
            {"mesh": 0, "extensions": {"EXT_mesh_gpu_instancing": instances}},
        ],
        "skins": [{"joints": [0, 1], "inverseBindMatrices": 3}],
        "meshes": [{"weights": [0.5], "primitives": [primitive]}],
        "materials": [
            {
                "emissiveFactor": [1, 1, 1],
                "extensions": {
                    "KHR_materials_pbrSpecularGlossiness": {"diffuseFactor": [0, 0, 0, 1]},
                    "KHR_materials_emissive_strength": {"emissiveStrength": 2},
                },
            }
        ],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": len(binary)}],
    }
    return glb(scene, binary)


def image_seeds() -> dict[str, bytes]:
    """Return small pictures with an EXIF orientation, and a 16-bit mask of labels."""
    exif = Image.Exif()
    exif[0x0112] = 6
    seeds = {}
    for kind in ("PNG", "JPEG"):
        buffer = io.BytesIO()
        Image.new("RGB", (3, 2), (200, 30, 90)).save(buffer, kind, exif=exif)
        seeds["turned_" + kind.lower()] = buffer.getvalue()
    buffer = io.BytesIO()
    Image.new("I;16", (3, 2), 1).save(buffer, "PNG")
    return {**seeds, "labels_png": buffer.getvalue()}


def write(folder: str, seeds: dict[str, bytes]) -> None:
    """Write seeds into a folder of the corpus."""
    target = HERE / "corpus" / folder
    target.mkdir(parents=True, exist_ok=True)
    for name, content in seeds.items():
        (target / name).write_bytes(content)
        print(f"{target / name}: {len(content)} bytes")


def main() -> None:
    """Write every seed."""
    write("zip", zip_seeds())
    write("graph", {name: graph_seed(name) for name in TOYS})
    imagenet = json.loads(card_seed("toy_cnn")) | {"labels": "imagenet-1k", "probe": None}
    write("card", {name: card_seed(name) for name in TOYS} | {"imagenet": compact(imagenet)})
    obj = b"ov 0 0 0 1 0 0\nv 1 0 0 0 1 0\nv 0 1 0 0 0 1\nv 1 1 0\nvt 0 0\nf 1/1 2/1 -1/1 3/1\n"
    write("image", image_seeds())
    polygon = (
        b"ov 2 1 0\nv 1 1 0\nv 1 2 0 # a\nv 0 2 0\nv 0 0 1e-400\nv 4e6 +0 .5\nvt 1\n"
        b'mtllib "a b.mtl" c.mtl\nusemtl\nF 1/1 2/1 3/1 \\\n4/1 5/1 6/1 # b\n'
    )
    mtl = (
        b'mnewmtl one # x\nKd 0 0 0\nKe 1\nmap_Kd -s 2 2 1 -o .5 -mm 0 1 -clamp on "a b.png"\n'
        b'map_Ke -bm 1\nnewmtl "two"\nmap_kd C:\\x\\y.png\n'
    )
    seeds = {"triangle_glb": glb_seed(), "rich_glb": rich_glb_seed(), "quad_obj": obj}
    write("asset", seeds | {"polygon_obj": polygon, "material_mtl": mtl})


if __name__ == "__main__":
    main()
