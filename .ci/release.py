"""Build the release that HEAD would be and try it elsewhere: `python3 .ci/release.py`.

It must have strict metadata, a wheel of at most 5 MB and a description without dead links. The
wheel, installed in an environment of its own, must run README's first command and pass the fast
tests of the source distribution.
"""

import re
import shutil
import subprocess
import sys
import tempfile
import tomllib
from pathlib import Path

REPOSITORY = Path(__file__).parents[1]
DIST = REPOSITORY / "build" / "release"
WHEEL_LIMIT = 5_000_000  # bytes
RELATIVE = re.compile(r"(!?)\[([^\]]*)\]\((?!https?:|#)([^)]+)\)")
RENDER = "import sys, readme_renderer.markdown as m; print(m.render(sys.stdin.read()))"


def run(*command: object, cwd: Path, **options) -> subprocess.CompletedProcess:
    """Run a command and show it; what fails ends the script."""
    print("+", *command, flush=True)
    return subprocess.run([str(part) for part in command], cwd=cwd, check=True, **options)


def description(readme: str, files: str | None) -> str:
    """README for a package index: links lead to `files`; where that is None, they become words."""

    def written(link: re.Match) -> str:
        picture, text, path = link.groups()
        if files:
            return f"{picture}[{text}]({files}/{path})"
        return f"*Picture: {text} (`{path}`).*" if picture else f"{text} (`{path}`)"

    note = "" if files else "\nFiles that are named here are in the source distribution.\n"
    return RELATIVE.sub(written, readme) + note


def main() -> None:
    """Build, check, install, test."""
    work = Path(tempfile.mkdtemp(prefix="qdenv-release-"))
    run("git", "archive", "--prefix=source/", f"--output={work}/source.tar", "HEAD", cwd=REPOSITORY)
    shutil.unpack_archive(work / "source.tar", work)
    readme = (work / "source" / "README.md").read_text()
    project = tomllib.loads((work / "source" / "pyproject.toml").read_text())["project"]
    files = project.get("urls", {}).get("Files")  # what README's relative links begin with
    text = description(readme, files)
    (work / "source" / "README.md").write_text(text)

    run(sys.executable, "-m", "venv", "tools", cwd=work)
    run("tools/bin/pip", "install", "-q", "build", "twine", "readme_renderer[md]", cwd=work)
    shutil.rmtree(DIST, ignore_errors=True)
    run(
        "tools/bin/python",
        "-m",
        "build",
        "--outdir",
        DIST,
        "source",
        cwd=work,
        stdout=subprocess.DEVNULL,
    )
    (wheel,), (sdist,) = DIST.glob("*.whl"), DIST.glob("*.tar.gz")
    run("tools/bin/twine", "check", "--strict", wheel, sdist, cwd=work)
    shown = run(
        "tools/bin/python", "-c", RENDER, cwd=work, input=text, text=True, stdout=subprocess.PIPE
    ).stdout
    if dead := re.findall(r'(?:src|href)="(?!https?:|#)[^"]*"', shown):
        sys.exit(f"links of the description that lead nowhere: {dead}")
    if (size := wheel.stat().st_size) > WHEEL_LIMIT:
        sys.exit(f"{wheel.name} has {size:,} bytes, more than {WHEEL_LIMIT:,}")

    outside = work / "outside"
    outside.mkdir()
    install, command = readme.split("```bash\n")[1].partition("```")[0].splitlines()
    run("bash", "-c", install.replace("-q .", f"-q {wheel}"), cwd=outside)
    run("bash", "-c", command, cwd=outside)
    run(".venv/bin/pip", "install", "-q", f"qdenv[dev] @ file://{wheel}", cwd=outside)
    run("tar", "-xzf", sdist, "--strip-components=1", cwd=outside)
    shutil.rmtree(outside / "qdenv")  # its place takes what is installed
    (installed,) = outside.glob(".venv/lib/*/site-packages/qdenv")
    (outside / "qdenv").symlink_to(installed)
    (outside / "README.md").write_text(readme)
    run(".venv/bin/python", "-m", "pytest", "-m", "fast", cwd=outside)
    shutil.rmtree(work)
    print(f"in {DIST}: wheel {size:,} bytes, source {sdist.stat().st_size:,} bytes")
    if not files:
        print("no [project.urls] Files in pyproject.toml: the description has no pictures")


if __name__ == "__main__":
    main()
