"""``python -m excavatwin.simulation OUT --seed 7``: render the sample anew."""

from __future__ import annotations

from pathlib import Path

import cyclopts

app = cyclopts.App(help="Render the sample site: photos with EXIF, and their truth.")


@app.default
def main(out: Path, seed: int = 7, views: int = 14, width: int = 1280) -> None:
    """Render photos and truth into OUT.

    Args:
        out: Folder to write into; made when missing.
        seed: Seed of the site, the flight and the noise.
        views: Number of photos.
        width: Width of the photos in pixels.
    """
    from excavatwin.simulation.sample import render_sample

    render_sample(out, seed, views, width)


if __name__ == "__main__":
    app()
