"""The command line: which commands there are. Their code is imported when one is called."""

from __future__ import annotations

from cyclopts import App

import excavatwin

# At most 79 columns, so that no terminal wraps what people copy.
EXAMPLES = """\
Examples:
  excavatwin map photos/ -o site               # photos -> map
  excavatwin map flight.mp4 -o site            # video -> map
  excavatwin map photos/ -o site --reconstructor vggt --segmenter yoloe
  excavatwin backbones                         # who can reconstruct, segment
  excavatwin fuse observations.npz -o site     # your own models' points -> map
  excavatwin config > settings.toml            # every parameter, with meaning
  excavatwin layers                            # what is in a map
  excavatwin doctor --photos 75                # what is installed, memory need

Add --debug to see where an error comes from."""

MAP = """\
Map a folder of photos (JPEG, PNG, TIFF) or a video.

Finished stages are kept beside the results: run again with another parameter
and only what depends on it is computed again; after an interruption the same
command resumes."""

MAP_EXAMPLES = """\
Every parameter of every stage is a flag, too: `excavatwin config` lists them.

Examples:
  excavatwin map photos/ -o site
  excavatwin map flight.mp4 -o site
  # another fusion parameter: seconds, the photos are not touched again
  excavatwin map photos/ -o site --mapper.decision.tau 0.5
  # a known length of 4.2 m between two pixels of a photo
  excavatwin map photos/ -o site --reference "IMG_9.JPG:1200,840:1510,861=4.2"
  # other backbones (`excavatwin backbones` lists them), their own parameters
  excavatwin map photos/ -o site --reconstructor vggt --vggt.chunking.size 32
  excavatwin map photos/ -o site --reconstructor colmap:workspace/
  excavatwin map photos/ -o site --segmenter yoloe --segmenter mask2former
  excavatwin map photos/ -o site --segmenter masks:labels/ --map "mud=nothing"
  # all parameters in a file
  excavatwin config > settings.toml
  excavatwin map photos/ -o site --config settings.toml"""

FUSE = """\
Fuse points and classes that your own models made.

An observations file (.npz) holds points (S,H,W,3) with NaN for none,
confidence (S,H,W), evidence (S,H,W,5) or labels (S,H,W), T_world_cam (S,4,4)
camera-to-world with OpenCV axes, and K (S,3,3). Views of different sizes come
as a folder with one .npz each and a views.json. No image is touched."""

FUSE_EXAMPLES = """\
Every parameter of the mapper is a flag, too: `excavatwin config` lists them.

Examples:
  excavatwin fuse observations.npz -o site
  excavatwin fuse observations.npz -o site --mapper.decision.tau 0.5
  # labels in the classes of another data set
  excavatwin fuse observations.npz -o site --class-mapping ade20k-150"""

CONFIG = "Every parameter of every stage with its meaning, as TOML that --config takes."

CONFIG_EXAMPLES = """\
Examples:
  excavatwin config > settings.toml
  excavatwin config --mapper.decision.tau 0.5 > settings.toml
  excavatwin map photos/ -o site --config settings.toml"""

BACKBONES = """\
Reconstructors and segmenters that can be chosen, and the state of each here.

Installed? weights? licence, metric or not, memory, what to type next."""

BACKBONES_EXAMPLES = """\
Examples:
  excavatwin backbones
  excavatwin backbones vggt                    # all about one
  excavatwin backbones --json                  # for programs"""

CHECK_BACKBONE = """\
Is a backbone wired up right? The conformance suite, row by row.

Card, parameters, output contract, conventions of poses and pixels, odd photos,
no network. Without --photos a small site is rendered, and reconstructors are
compared with its exact truth. Exit code 2 when a promise is broken."""

CHECK_BACKBONE_EXAMPLES = """\
Examples:
  excavatwin check-backbone photogrammetry
  excavatwin check-backbone mask2former:weights/ --mask2former.device.name cpu
  excavatwin check-backbone colmap:workspace/ --photos photos/"""

DOCTOR = "What is installed, what each backbone needs, and the memory for N photos."

DOCTOR_EXAMPLES = """\
Examples:
  excavatwin doctor
  excavatwin doctor --photos 75 --lattice 640"""

DEMO = "Map the photos that ship with the project and compare with the known truth."

DEMO_EXAMPLES = """\
Examples:
  excavatwin demo -o demo_output"""

DATASETS = """\
Data sets that can be read: what to download, where it goes, which terms.

With FOLDERS: which data set lies there, what it holds and lacks, whether
its calibration fits, and which known bad files are left out."""

DATASETS_EXAMPLES = """\
Examples:
  excavatwin datasets
  excavatwin datasets ~/Rellis-3D
  excavatwin datasets ~/goose_2d_val ~/goose_3d_val
  # below the folder in the environment variable EXCAVATWIN_DATASETS
  excavatwin datasets goose-ex --all"""

EVALUATE = """\
Score a SITE, or every site of a data set, against what is true.

Elevation, classes, objects; for a data set also dimensions by protocols in
which no object sets its own scale, volumes between epochs, and intervals over
sequences. Simulated sites without a SITE are mapped first, and kept."""

EVALUATE_EXAMPLES = """\
Examples:
  excavatwin evaluate demo_output --truth sample/truth.npz
  excavatwin evaluate site --truth lidar_dtm.tif --csv metrics.csv
  excavatwin evaluate oces/ --sites sites/ -o scores
  excavatwin evaluate oces/ --sites sites/ --reference lidar --align cameras
  excavatwin evaluate rellis/ --sites sites/ --policy strict --no-map"""

COMPARE = """\
Compare two maps of one site: two backbones, or two settings.

Heights (B minus A), classes, coverage, objects, and what differs in how the
maps were made. Neither is taken for the truth: `evaluate` does that."""

COMPARE_EXAMPLES = """\
Examples:
  excavatwin compare site_a site_b
  excavatwin compare site_a site_b -o comparison
  # GPS of a phone: let the photos of equal names place B, not the georeference
  excavatwin compare site_a site_b --align cameras"""

SIMULATE = """\
Record made-up dig sites: photos, and the truth of every pixel and cell.

Sites, machines, flights and errors are drawn from the seed. Finished epochs
are kept: after an interruption the same command resumes."""

SIMULATE_EXAMPLES = """\
Examples:
  excavatwin simulate -o simulated
  excavatwin simulate -o simulated --seed 5 --epochs 4 --width 1024
  # as real as it gets: pip install "excavatwin[sim]"
  excavatwin simulate -o real --renderer photoreal --width 1024
  excavatwin simulate -o dusk --sun-elevation 12 --dust 1 --motion-blur 2
  # a data set of 25 sequences like the paper's OCES
  excavatwin simulate -o oces --sequences 25 --epochs 4 --flight mixed"""

GROUND_FILTERS = """\
Compare ground filters on plain clouds: ours, CSF, PMF, SMRF.

Type I, type II and total error and kappa, each peer with its published and
with its best parameters. Needs: pip install "excavatwin[study]"."""

GROUND_FILTERS_EXAMPLES = """\
Examples:
  excavatwin ground-filters --simulated 4 -o filters
  excavatwin ground-filters --isprs ISPRS_filtertest/ -o filters"""

ABLATE = """\
What each part of the method is worth: ablations, baselines, oracles.

The paper's five rows, the full method, fusions that everybody knows, and the
full method with true classes or true geometry; paired by case, with intervals.
Finished cases are kept: a stopped run goes on."""

ABLATE_EXAMPLES = """\
Every parameter of the mapper is a flag, too: `excavatwin config` lists them.

Examples:
  excavatwin ablate -o ablation                # 20 simulated sites
  excavatwin ablate --simulated 4 --backbone yoloe -o ablation
  excavatwin ablate --only "plain 3D voting" --simulated 4 -o ablation
  # observations of your own, with what is true about them
  excavatwin ablate observations.npz --truth truth.npz -o ablation"""

TABLES = """\
The tables of the paper, our column beside the paper's.

Geometry, semantics, ablation, as Markdown, LaTeX, JSON and CSV. OCES is filled
from simulated sites, other columns from the data sets that you give."""

TABLES_EXAMPLES = """\
Examples:
  excavatwin tables -o tables                  # 20 simulated sites
  excavatwin tables rellis/ --sites rellis_sites/ -o tables
  excavatwin tables goose/ --sites goose_sites/ --segmenter yoloe -o tables"""

app = App(
    name="excavatwin",
    help="Photos of an earthworks site in, metric semantic elevation map out: no LiDAR, no training, no GPU needed.",
    help_format="plaintext",
    help_epilogue=EXAMPLES,
    version=f"excavatwin {excavatwin.__version__}",
    exit_on_error=False,
    print_error=False,
)


def _register(place: str, name: str, help: str, epilogue: str = "") -> None:
    app.command(f"excavatwin.cli.{place}", name=name, help=help, help_epilogue=epilogue, sort_key=len(list(app)))


_register("mapping:map_command", "map", MAP, MAP_EXAMPLES)
_register("mapping:fuse_command", "fuse", FUSE, FUSE_EXAMPLES)
_register("reference_pages:layers_command", "layers", "What is in a map: layers, classes, reasons, with their ids.")
_register("reference_pages:config_command", "config", CONFIG, CONFIG_EXAMPLES)
_register("backbones:backbones_command", "backbones", BACKBONES, BACKBONES_EXAMPLES)
_register("check_backbone:check_backbone_command", "check-backbone", CHECK_BACKBONE, CHECK_BACKBONE_EXAMPLES)
_register("doctor:doctor_command", "doctor", DOCTOR, DOCTOR_EXAMPLES)
_register("demo:demo_command", "demo", DEMO, DEMO_EXAMPLES)
_register("datasets:datasets_command", "datasets", DATASETS, DATASETS_EXAMPLES)
_register("evaluate:evaluate_command", "evaluate", EVALUATE, EVALUATE_EXAMPLES)
_register("compare:compare_command", "compare", COMPARE, COMPARE_EXAMPLES)
_register("simulate:simulate_command", "simulate", SIMULATE, SIMULATE_EXAMPLES)
_register("ground_filters:ground_filters_command", "ground-filters", GROUND_FILTERS, GROUND_FILTERS_EXAMPLES)
_register("ablate:ablate_command", "ablate", ABLATE, ABLATE_EXAMPLES)
_register("tables:tables_command", "tables", TABLES, TABLES_EXAMPLES)
