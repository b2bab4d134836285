"""Makes the interfaces of rosapi, which are no wheel: generates their C with the wheels' rosidl, and compiles it.

Run while the image is built: `make_rosapi_msgs.py FOLDER`, as the Python with the wheels. rosbridge's own rosapi loads
the library under the name of each typesupport. Without them it does not start, and pages find no topics.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

from rosidl_adapter.msg import convert_msg_to_idl
from rosidl_adapter.srv import convert_srv_to_idl
from rosidl_generator_c.cli import GenerateC
from rosidl_generator_type_description.cli import HashTypeDescription
from rosidl_typesupport_c.cli import GenerateCTypesupport
from rosidl_typesupport_fastrtps_c.cli import GenerateFastRTPSCTypesupport
from rosidl_typesupport_introspection_c.cli import GenerateIntrospectionCTypesupport

PACKAGE = "rosapi_msgs"
PREFIX = Path(sys.prefix)
USED = ("builtin_interfaces", "service_msgs")
TYPESUPPORTS = ("rosidl_typesupport_fastrtps_c", "rosidl_typesupport_introspection_c")
LIBRARIES = ("rcutils", "rosidl_runtime_c", "fastcdr", "rosidl_typesupport_c", *TYPESUPPORTS)

DETAILS = "string type --- TypeDef[] typedefs"
SERVICES = {
    "ActionFeedbackDetails": DETAILS,
    "ActionGoalDetails": DETAILS,
    "ActionResultDetails": DETAILS,
    "ActionType": "string action --- string type",
    "DeleteParam": "string name --- bool successful, string reason",
    "GetActionServers": "--- string[] action_servers",
    "GetParam": "string name, string default_value --- string value, bool successful, string reason",
    "GetParamNames": "--- string[] names",
    "GetROSVersion": "--- uint8 version, string distro",
    "GetTime": "--- builtin_interfaces/Time time",
    "HasParam": "string name --- bool exists, bool successful, string reason",
    "Interfaces": "--- string[] interfaces",
    "MessageDetails": DETAILS,
    "NodeDetails": "string node --- string[] subscribing, string[] publishing, string[] services",
    "Nodes": "--- string[] nodes",
    "Publishers": "string topic --- string[] publishers",
    "ServiceNode": "string service --- string node",
    "ServiceProviders": "string service --- string[] providers",
    "ServiceRequestDetails": DETAILS,
    "ServiceResponseDetails": DETAILS,
    "ServiceType": "string service --- string type",
    "Services": "--- string[] services",
    "ServicesForType": "string type --- string[] services",
    "SetParam": "string name, string value --- bool successful, string reason",
    "Subscribers": "string topic --- string[] subscribers",
    "TopicType": "string topic --- string type",
    "Topics": "--- string[] topics, string[] types",
    "TopicsAndRawTypes": "--- string[] topics, string[] types, string[] typedefs_full_text",
    "TopicsForType": "string type --- string[] topics",
}
TYPEDEF = (
    "string type, string[] fieldnames, string[] fieldtypes, int32[] fieldarraylen,"
    "string[] examples, string[] constnames, string[] constvalues"
)


def lines(fields: str) -> str:
    """Write fields as ROS does, each on a line of its own."""
    return "".join(f"{line.strip()}\n" for line in fields.replace("---", ",---,").split(","))


def ensure_idl(folder: Path) -> list[str]:
    """Write the interfaces down and translate them; returns them as the generators take them."""
    files = []
    for name, fields in {"TypeDef": TYPEDEF, **SERVICES}.items():
        kind, convert = (
            ("srv", convert_srv_to_idl) if name in SERVICES else ("msg", convert_msg_to_idl)
        )
        (folder / kind).mkdir(parents=True, exist_ok=True)
        source = Path(kind) / f"{name}.{kind}"
        (folder / source).write_text(lines(fields))
        convert(folder, PACKAGE, source, folder / kind)
        files.append(f"{folder}:{kind}/{name}.idl")
    return files


def generate(folder: Path) -> list[Path]:
    """Generate the C of all interfaces; returns a folder for each generator, as their files bear the same names."""
    idl = folder / "idl"
    files = ensure_idl(idl)
    includes = [str(idl), *(str(PREFIX / "share" / name) for name in USED)]
    hashes = HashTypeDescription("hash").generate_type_hashes(PACKAGE, files, includes, idl)
    generators: dict[str, tuple[Any, ...]] = {
        "c": (GenerateC("c"), hashes),
        "dispatch": (GenerateCTypesupport("c", typesupport_implementations=TYPESUPPORTS),),
        "introspection": (GenerateIntrospectionCTypesupport("c"),),
        "fastrtps": (GenerateFastRTPSCTypesupport("c"),),
    }
    for name, (generator, *more) in generators.items():
        generator.generate(PACKAGE, files, includes, folder / name / PACKAGE, *more)
    return [folder / name for name in generators]


def sources(folder: Path) -> list[Path]:
    """Join what can be compiled in one go, as most of the time goes into the headers."""
    files = sorted(folder.rglob("*.c*"))
    # Each has constants of the types that it refers to, under the same names.
    alone = [file for file in files if file.name.endswith("__description.c")]
    joined = folder / f"joined{files[0].suffix}"
    joined.write_text("".join(f'#include "{file}"\n' for file in files if file not in alone))
    return [joined, *alone]


def compile_library(folders: list[Path]) -> None:
    """Compile all into one library, which each typesupport finds under its own name."""
    headers = [PREFIX / "include", *(PREFIX / "include").iterdir(), *folders]
    first, *others = ("rosidl_typesupport_c", *TYPESUPPORTS)
    library = PREFIX / "lib" / f"lib{PACKAGE}__{first}.so"
    used = [f"{name}__{kind}" for name in USED for kind in ("rosidl_generator_c", *TYPESUPPORTS)]
    subprocess.run(  # noqa: S603 - what this file makes
        [
            *("gcc", "-shared", "-fPIC", "-w", "-o", library),
            *(f"-I{path}" for path in headers),
            *(file for folder in folders for file in sources(folder)),
            *(f"-L{library.parent}", "-Wl,-rpath,$ORIGIN", "-Wl,--no-undefined", "-lstdc++"),
            *(f"-l{name}" for name in (*LIBRARIES, *used)),
        ],
        check=True,
    )
    for other in others:
        library.with_name(f"lib{PACKAGE}__{other}.so").symlink_to(library.name)


if __name__ == "__main__":
    compile_library(generate(Path(sys.argv[1]).resolve()))
