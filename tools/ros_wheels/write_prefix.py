"""Make this virtual environment of ROS wheels a normal ROS underlay: write its setup files.

The wheels bring every package's own hooks, but not the prefix-level setup.bash that sources
them. Those come from ament_package's templates, as they do in any ROS installation.
"""

import sys
from importlib import resources
from pathlib import Path

PREFIX = Path(sys.prefix)
VALUES = {
    "@CMAKE_INSTALL_PREFIX@": sys.prefix,
    "@ament_package_PYTHON_EXECUTABLE@": sys.executable,
    "@SKIP_PARENT_PREFIX_PATH@": "",
}
TEMPLATES = (
    "setup.bash",
    "setup.sh.in",
    "local_setup.bash",
    "local_setup.sh.in",
    "_local_setup_util.py",
)


def main() -> None:
    templates = resources.files("ament_package") / "template" / "prefix_level"
    for template in TEMPLATES:
        text = (templates / template).read_text()
        for placeholder, value in VALUES.items():
            text = text.replace(placeholder, value)
        (PREFIX / template.removesuffix(".in")).write_text(text)


if __name__ == "__main__":
    main()
