"""``python3 -m sgs_priors NETWORK=WEIGHTS ...``: one provider for all the networks that are named."""

import argparse
import importlib
import sys

from . import misbehave, service

#: Where each network's adapter is: its module and what it offers. Only the named ones are imported.
NETWORKS = {
    "stable-normal": ("stable_normal", "normals"),
    "depth-anything": ("depth_anything", "depth"),
    "depth-anything-3": ("depth_anything_3", "depth"),
    "lseg": ("lseg", "semantics"),
    "clip": ("clip_text", "text"),
    "qwen-vl": ("qwen_vl", "classes"),
    "sam2": ("sam2", "masks, regions"),
    "rgbx": ("rgbx", "materials"),
}


def make(networks, options):
    """The services of networks, given as pairs of name and path."""
    services = []
    for name, path in networks:
        if name == "stand-in":
            from .stand_in import StandIn
            services.append(StandIn(path, options.noise, options.frame, options.color, options.leak, options.depth))
        else:
            module = importlib.import_module(f".networks.{NETWORKS[name][0]}", __package__)
            services.append(module.load(path, options))
    return service.Several(services)


def main(arguments=None):
    """Reads the command line and serves."""
    parser = argparse.ArgumentParser(prog="sgs_priors", description=__doc__, epilog="networks: stand-in (a scene in place "
                                     "of weights), " + ", ".join(f"{n} ({o})" for n, (_, o) in NETWORKS.items()))
    parser.add_argument("network", nargs="+", metavar="NETWORK=WEIGHTS")
    parser.add_argument("--device", default=None, help="torch device; cuda where there is one, else cpu")
    parser.add_argument("--code", default=None, help="checkout of a network's repository, where it is no package")
    parser.add_argument("--steps", type=int, default=50, help="denoising steps of rgbx")
    parser.add_argument("--max-side", type=int, default=1024, help="longest side of the images that networks get")
    parser.add_argument("--noise", type=float, default=0.05, help="errors of the stand-in")
    parser.add_argument("--leak", type=float, default=0.0,
                        help="how much shading of the image is in the stand-in's albedo: 0 none, 1 all of it")
    parser.add_argument("--frame", default="camera-stablenormal", help="frame of the stand-in's normals",
                        choices=["world", "camera-opencv", "camera-opengl", "camera-stablenormal"])
    parser.add_argument("--color", default="srgb", choices=["srgb", "linear"], help="of the stand-in's albedo")
    parser.add_argument("--free-scale", action="store_true",
                        help="metric depth counts up to a factor of each view, for scenes whose unit is not the meter")
    parser.add_argument("--depth", default=None, choices=["metric", "scale", "inverse-scale-shift"],
                        help="meaning of the stand-in's depth; without it, it offers none")
    options = parser.parse_args(arguments)
    networks = [n.partition("=")[::2] for n in options.network]
    for name, path in networks:
        if name not in ("stand-in", "misbehave", *NETWORKS) or not path:
            parser.error(f"\"{name}={path}\" is not NETWORK=WEIGHTS; networks are stand-in, {', '.join(NETWORKS)}")
    if networks[0][0] == "misbehave":
        misbehave.main(networks[0][1])
        return 0
    service.serve(lambda: make(networks, options))
    return 0


if __name__ == "__main__":
    sys.exit(main())
