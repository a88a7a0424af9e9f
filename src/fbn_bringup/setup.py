"""Install this package into a ROS workspace; name and version come from package.xml."""

from pathlib import Path
from xml.etree import ElementTree

from setuptools import find_packages, setup

manifest = ElementTree.parse("package.xml").getroot()
name = manifest.findtext("name")
share = f"share/{name}"
rooms = {path.parent for room in ("launch", "config") for path in Path(room).rglob("*.*")}

setup(
    name=name,
    version=manifest.findtext("version"),
    description=manifest.findtext("description"),
    license=manifest.findtext("license"),
    packages=find_packages(include=[name, f"{name}.*"]),
    package_data={"": ["py.typed", "data/**"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{name}"]),
        (share, ["package.xml"]),
        *((f"{share}/{room}", [str(f) for f in room.iterdir() if f.is_file()]) for room in rooms),
    ],
    extras_require={"test": ["pytest"]},
)
