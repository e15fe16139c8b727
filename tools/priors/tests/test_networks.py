"""The adapters. CLIP, Qwen3-VL and SAM 2 run as their library's own classes at random small weights; StableNormal, LSeg,
RGB to X and VGGT are fakes of the same interface, made here. Needs torch, transformers, torchvision, numpy and pillow;
without them everything is skipped. ``make test-priors`` runs it.
"""

import contextlib
import io
import json
import os
import subprocess
import sys
import tempfile
import types
import unittest
import unittest.mock

ROOT = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
sys.path[:0] = [ROOT, os.path.dirname(os.path.abspath(__file__))]
os.environ.update(HF_HUB_OFFLINE="1", TOKENIZERS_PARALLELISM="false")

try:
    import numpy as np
    import torch
    import transformers
    from PIL import Image

    transformers.logging.set_verbosity_error()
    MISSING = None
except ImportError as e:
    MISSING = str(e)

from sgs_priors import protocol  # noqa: E402
from sgs_priors.service import Question, Refusal  # noqa: E402

OPTIONS = types.SimpleNamespace(device="cpu", code=None, steps=2, max_side=64, free_scale=False)


def ramp(height, width):
    """Red grows to the right, green downwards, as sRGB codes."""
    image = np.zeros((height, width, 3), np.uint8)
    image[..., 0] = np.linspace(0, 255, width).astype(np.uint8)[None]
    image[..., 1] = np.linspace(0, 255, height).astype(np.uint8)[:, None]
    image[..., 2] = 128
    return image


def ask(service, name, *images, **more):
    """An answer through the wire's own codec, with arrays as numpy."""
    from sgs_priors import tensors

    text = {"question": name, "id": 1, "views": [{} for _ in images], "seed": 42, **more}
    arrays = {f"image{i}": tensors.to_array(image) for i, image in enumerate(images)}
    text, arrays = service.answer(Question(*protocol.decode(protocol.encode(text, arrays))))
    text, arrays = protocol.decode(protocol.encode(text, arrays))
    return text, {n: tensors.from_array(a) for n, a in arrays.items()}


@unittest.skipIf(MISSING, MISSING)
class Tensors(unittest.TestCase):
    def test_arrays_survive(self):
        from sgs_priors import tensors

        for kind in tensors.TYPES.values():
            numbers = np.arange(12).reshape(3, 4).astype(kind)
            np.testing.assert_array_equal(tensors.from_array(tensors.to_array(numbers[:, ::2])), numbers[:, ::2])

    def test_colors(self):
        from sgs_priors import tensors

        codes = np.arange(256, dtype=np.uint8).reshape(1, 256, 1).repeat(3, 2)
        sent = tensors.to_array(codes)
        light = tensors.linear(sent)
        self.assertAlmostEqual(float(light[0, 128, 0]), 0.215861, 5)
        np.testing.assert_allclose(tensors.srgb(tensors.to_array(light.astype(np.float32))), tensors.srgb(sent), atol=1e-5)
        np.testing.assert_array_equal(np.asarray(tensors.picture(sent)), codes)
        hot = tensors.to_array(np.full((1, 1, 3), 7, np.float32))
        self.assertAlmostEqual(float(tensors.srgb(hot).max()), 1, 5)
        self.assertEqual(float(tensors.linear(hot).max()), 7)

    def test_sizes(self):
        from sgs_priors import tensors

        self.assertEqual(tensors.multiple(120, 160, 14, 518), (126, 154))
        self.assertEqual(tensors.multiple(1000, 2000, 14, 518), (252, 518))
        self.assertEqual(tensors.multiple(3, 2000, 32, 480), (32, 480))
        np.testing.assert_allclose(tensors.confidence(np.array([0.5, 1, 2, 5, np.inf, np.nan])), [0, 0, 0.5, 0.8, 1, 0])
        image = np.random.default_rng(0).random((8, 12, 3), np.float32)
        small = tensors.resize(image, 4, 6)
        self.assertAlmostEqual(float(small.mean()), float(image.mean()), 2)
        self.assertEqual(tensors.resize(image, 20, 30).shape, (20, 30, 3))


@unittest.skipIf(MISSING, MISSING)
class Real(unittest.TestCase):
    """The library's own classes, loaded by the adapters from what the library has saved."""

    @classmethod
    def setUpClass(cls):
        import networks_small

        cls.folder = tempfile.TemporaryDirectory()
        with contextlib.redirect_stderr(io.StringIO()):
            for name in ("clip", "sam2", "qwen", "depth_anything"):
                os.mkdir(os.path.join(cls.folder.name, name))
                getattr(networks_small, name)(os.path.join(cls.folder.name, name))

    @classmethod
    def tearDownClass(cls):
        cls.folder.cleanup()

    def load(self, module, name):
        import importlib

        return importlib.import_module(f"sgs_priors.networks.{module}").load(os.path.join(self.folder.name, name), OPTIONS)

    def test_depth_anything(self):
        service = self.load("depth_anything", "depth_anything")
        self.assertEqual(service.offers, {"depth": {"max_side": 64}})
        text, arrays = ask(service, "depth", ramp(40, 60))
        self.assertEqual((text["meaning"], set(arrays)), ("inverse-scale-shift", {"depth"}))
        depth = arrays["depth"]
        self.assertEqual((depth.shape, depth.dtype), ((40, 60), np.float32))
        self.assertTrue(np.isfinite(depth).all() and depth.std() > 0)
        np.testing.assert_array_equal(ask(service, "depth", ramp(40, 60))[1]["depth"], depth)
        # The library's own way from an image to depth of its size, up to how sizes are changed.
        model, processor = service.model, service.processor
        inputs = processor(images=Image.fromarray(ramp(40, 60)), return_tensors="pt")
        with torch.no_grad():
            made = processor.post_process_depth_estimation(model(**inputs), [(40, 60)])[0]["predicted_depth"].numpy()
        self.assertLess(np.abs(made - depth).mean(), 0.1 * depth.std() + 1e-4)
        with tempfile.TemporaryDirectory() as folder, self.assertRaisesRegex(Refusal, "no saved model"):
            from sgs_priors.networks import depth_anything

            depth_anything.load(folder, OPTIONS)
        with self.assertRaisesRegex(Refusal, "not depth_anything"):
            import networks_small

            with tempfile.TemporaryDirectory() as folder:
                networks_small.other_depth(folder)
                depth_anything.load(folder, OPTIONS)

    def test_clip(self):
        service = self.load("clip_text", "clip")
        self.assertEqual(service.offers, {"text": {"channels": 24}})
        names = ["chair", "a very long name that does not fit the network at all", "lamp"]
        text, arrays = ask(service, "text", names=names)
        self.assertEqual(text["names"], names)
        found = arrays["embeddings"]
        self.assertEqual((found.shape, found.dtype), ((3, 24), np.float32))
        np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1, atol=1e-5)
        self.assertGreater(np.abs(found[0] - found[2]).max(), 0.01)
        # Alone or among others, a name has the same embedding.
        np.testing.assert_allclose(ask(service, "text", names=["lamp"])[1]["embeddings"][0], found[2], atol=1e-5)

    def test_sam2_masks(self):
        service = self.load("sam2", "sam2")
        frames = [ramp(30, 50), ramp(30, 50)[::-1].copy(), ramp(30, 50)]
        masks = ask(service, "masks", *frames, point=[10.5, 20.5])[1]["masks"]
        self.assertEqual((masks.shape, masks.dtype), ((3, 30, 50), np.bool_))
        np.testing.assert_array_equal(ask(service, "masks", *frames, point=[10.5, 20.5])[1]["masks"], masks)
        drawn = ask(service, "masks", *frames)[1]["masks"]
        np.testing.assert_array_equal(ask(service, "masks", *frames)[1]["masks"], drawn)

    def test_sam2_sees_the_point_where_it_is(self):
        # The prompt must reach the network in its own pixels, of which it has 128 a side.
        service = self.load("sam2", "sam2")
        session = service.video_processor.init_video_session(video=[ramp(30, 50)] * 3, dtype=torch.float32)
        service.video_processor.add_inputs_to_inference_session(
            inference_session=session, frame_idx=0, obj_ids=1, input_points=[[[[25.0, 15.0]]]], input_labels=[[[1]]])
        seen = session.point_inputs_per_obj[0][0]["point_coords"].flatten().tolist()
        self.assertEqual(seen, [64.0, 64.0])

    def test_sam2_regions(self):
        from sgs_priors.networks import sam2

        service = self.load("sam2", "sam2")
        with unittest.mock.patch.multiple(sam2, TRUST=-10, STABLE=0, GRID=4):
            ids = ask(service, "regions", ramp(30, 50))[1]["regions"]
        self.assertEqual((ids.shape, ids.dtype), ((30, 50), np.uint16))
        self.assertGreater(ids.max(), 0, "random weights should have masked something")

    def test_qwen(self):
        service = self.load("qwen_vl", "qwen")
        service.max_tokens = 12
        words = service.say(_question("classes", ramp(40, 60), ramp(60, 40)))
        self.assertIsInstance(words, str)
        self.assertEqual(words, service.say(_question("classes", ramp(40, 60), ramp(60, 40))))
        service.say = lambda question: "Here: [\"Sofa\", \"wall\", \"sofa\"]"
        self.assertEqual(ask(service, "classes", ramp(8, 8))[0]["names"], ["sofa", "wall"])
        service.say = lambda question: " . "
        with self.assertRaisesRegex(Refusal, "named nothing"):
            ask(service, "classes", ramp(8, 8))

    def test_from_the_command_line(self):
        places = [f"{n}={os.path.join(self.folder.name, f)}" for n, f in (("clip", "clip"), ("sam2", "sam2"))]
        stream = io.BytesIO()
        protocol.write(stream, {"kind": "hello", "versions": [1, 1]})
        protocol.write(stream, {"kind": "question", "id": 1, "question": "text", "names": ["sofa"]})
        command = [sys.executable, "-B", os.path.join(ROOT, "serve"), *places, "--device", "cpu"]
        done = subprocess.run(command, input=stream.getvalue(), capture_output=True, check=True)
        answers = io.BytesIO(done.stdout)
        greeting, answer = protocol.read(answers), protocol.read(answers)
        self.assertEqual(set(greeting[0]["offers"]), {"text", "masks", "regions"})
        self.assertEqual((answer[0]["to"], answer[1]["embeddings"].shape), (1, (1, 24)))
        done = subprocess.run([*command[:3], "clip=/nowhere"], input=stream.getvalue(), capture_output=True, check=True)
        self.assertEqual(protocol.read(io.BytesIO(done.stdout))[0]["text"], "there is no saved model at /nowhere")


def _question(name, *images):
    from sgs_priors import tensors

    arrays = {f"image{i}": tensors.to_array(image) for i, image in enumerate(images)}
    return Question({"question": name, "id": 1, "views": []}, arrays)


@unittest.skipIf(MISSING, MISSING)
class Fakes(unittest.TestCase):
    """What is around the network, with a network that is made here."""

    def test_stable_normal(self):
        from sgs_priors.networks.stable_normal import StableNormal

        sizes = []

        def predictor(image):
            sizes.append((image.mode, image.size))
            # Up and to the left, as color; and at half the size, as such networks may.
            n = np.array([0.6, 0.8, 0.0]) * 0.5 + 0.5
            color = (n * 255 + 0.5).astype(np.uint8)
            return Image.fromarray(np.tile(color, (image.height // 2, image.width // 2, 1)))

        service = StableNormal(predictor, 64)
        self.assertEqual(service.offers, {"normals": {"max_side": 64}})
        text, arrays = ask(service, "normals", ramp(20, 30))
        self.assertEqual((text["frame"], sizes), ("camera-stablenormal", [("RGB", (30, 20))]))
        self.assertEqual((arrays["normals"].shape, arrays["normals"].dtype), ((20, 30, 3), np.float32))
        np.testing.assert_allclose(arrays["normals"].reshape(-1, 3), np.tile([0.6, 0.8, 0], (600, 1)), atol=0.01)

    def test_depth_anything(self):
        from sgs_priors.networks.depth_anything import DepthAnything

        class Model:
            device = torch.device("cpu")

            def __init__(self, **config):
                self.config = types.SimpleNamespace(**config)

            def __call__(self, pixel_values):
                depth = torch.arange(12.0).reshape(1, 3, 4) - 1
                depth[0, 2, 3] = float("nan")
                return types.SimpleNamespace(predicted_depth=depth)

        class Inputs(dict):
            def to(self, device):
                return self

        def processor(images, return_tensors):
            self.assertEqual((images.size, return_tensors), ((4, 3), "pt"))
            return Inputs(pixel_values=torch.zeros(1, 3, 3, 4))

        def found(free_scale=False, **config):
            text, arrays = ask(DepthAnything(Model(**config), processor, 64, free_scale), "depth", ramp(3, 4))
            return text["meaning"], arrays["depth"]
        meaning, depth = found(depth_estimation_type="relative")
        self.assertEqual(meaning, "inverse-scale-shift")
        np.testing.assert_array_equal(depth.ravel(), [-1, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, np.nan])
        self.assertEqual(found(True, depth_estimation_type="relative")[0], "inverse-scale-shift")
        self.assertEqual(found()[0], "inverse-scale-shift")
        meaning, depth = found(depth_estimation_type="metric")
        self.assertEqual(meaning, "metric")
        np.testing.assert_array_equal(depth.ravel(), [np.nan, np.nan, 1, 2, 3, 4, 5, 6, 7, 8, 9, np.nan])
        self.assertEqual(found(True, depth_estimation_type="metric")[0], "scale")

    def test_depth_anything_3(self):
        from sgs_priors.networks.depth_anything_3 import DepthAnything3

        class Network:
            def __init__(self, name, conf):
                self.model_name, self.conf = name, conf

            def inference(self, images):
                (image,) = images
                shape = (1, image.height // 2, image.width // 2)
                conf = np.full(shape, 4.0, np.float32) if self.conf else None
                return types.SimpleNamespace(depth=np.full(shape, 6.0, np.float32), conf=conf)

        def found(name, conf=True, camera=None, free_scale=False):
            views = [{"camera": camera}] if camera else [{}]
            service = DepthAnything3(Network(name, conf), 64, free_scale)
            self.assertEqual(service.offers, {"depth": {"max_side": 64}})
            return ask(service, "depth", ramp(20, 30), views=views)
        text, arrays = found("da3-large")
        self.assertEqual((text["meaning"], arrays["depth"].shape), ("scale", (20, 30)))
        np.testing.assert_allclose(arrays["depth"], 6, rtol=1e-6)
        np.testing.assert_allclose(arrays["confidence"], 0.75, rtol=1e-6)
        # Half of the focal length of the image, in units of 300 pixels.
        camera = {"width": 30, "height": 20, "fx": 200.0, "fy": 200.0, "cx": 15.0, "cy": 10.0}
        text, arrays = found("da3metric-large", False, camera)
        self.assertEqual((text["meaning"], set(arrays)), ("metric", {"depth"}))
        np.testing.assert_allclose(arrays["depth"], 6 * 100 / 300, rtol=1e-6)
        with self.assertRaisesRegex(Refusal, "needs the focal length"):
            found("da3metric-large")
        text, arrays = found("da3metric-large", free_scale=True)
        self.assertEqual((text["meaning"], float(arrays["depth"][0, 0])), ("scale", 6.0))
        text, arrays = found("da3nested-giant-large")
        self.assertEqual((text["meaning"], float(arrays["depth"][0, 0])), ("metric", 6.0))

    def test_lseg(self):
        from sgs_priors.networks.lseg import LSeg

        class Network(torch.nn.Module):
            def __init__(self):
                super().__init__()
                self.head1 = torch.nn.Conv2d(3, 512, 2, 2)
                self.seen = None

            def forward(self, x):
                self.seen = x
                return self.head1(x).sum(1)

        network = Network()
        service = LSeg(network, network.head1)
        features = ask(service, "semantics", ramp(120, 160))[1]["features"]
        self.assertEqual((features.shape, features.dtype), ((64, 80, 512), np.float16))
        seen = network.seen
        self.assertEqual(tuple(seen.shape), (1, 3, 128, 160))
        self.assertLess(float(seen[0, 0, :, 0].max()), -0.98)
        self.assertGreater(float(seen[0, 0, :, -1].min()), 0.98)
        with torch.no_grad():
            wanted = network.head1(seen)[0, :, 10, 20].half().numpy()
        np.testing.assert_array_equal(features[10, 20], wanted)
        self.assertEqual(len(network.head1._forward_hooks), 0)
        with self.assertRaisesRegex(Refusal, "not \\[1, 512, h, w\\]"):
            ask(LSeg(network, torch.nn.Identity()), "semantics", ramp(32, 32))

    def test_rgbx(self):
        from sgs_priors.networks.rgbx import Rgbx

        calls = []

        def pipeline(**options):
            calls.append(options)
            noise = int(torch.randint(0, 50, (1,), generator=options["generator"]))
            made = np.full((options["height"], options["width"], 3), 100 + noise, np.uint8)
            return types.SimpleNamespace(images=[[Image.fromarray(made)]])

        service = Rgbx(pipeline, "cpu", steps=7, max_side=64)
        self.assertEqual(service.offers["materials"],
                         {"image": "linear", "max_side": 64, "maps": ["albedo", "roughness", "metallic"]})
        light = np.full((21, 30, 3), 0.25, np.float32)
        light[0, 0] = 9
        text, arrays = ask(service, "materials", light, maps=["albedo", "metallic"])
        self.assertEqual((text["color"], set(arrays)), ("srgb", {"albedo", "metallic"}))
        self.assertEqual((arrays["albedo"].shape, arrays["metallic"].shape), ((21, 30, 3), (21, 30)))
        first, second = calls
        self.assertEqual((first["prompt"], first["required_aovs"]), ("Albedo (diffuse basecolor)", ["albedo"]))
        self.assertEqual((second["prompt"], second["num_inference_steps"]), ("Metallicness", 7))
        self.assertEqual((first["height"], first["width"]), (24, 32))
        photo = first["photo"]
        self.assertEqual(tuple(photo.shape), (3, 24, 32))
        # Linear as it came, and clipped.
        self.assertAlmostEqual(float(photo[0, 12, 16]), 0.25, 5)
        self.assertLessEqual(float(photo.max()), 1.0)
        again = ask(service, "materials", light, maps=["albedo"])[1]["albedo"]
        np.testing.assert_array_equal(again, arrays["albedo"])
        # An 8-bit image would be sRGB; the network still gets light.
        ask(service, "materials", np.full((8, 8, 3), 128, np.uint8), maps=["roughness"])
        self.assertAlmostEqual(float(calls[-1]["photo"].mean()), 0.215861, 4)
        with self.assertRaisesRegex(Refusal, "no map \"beauty\""):
            ask(service, "materials", light, maps=["beauty"])

    def test_vggt(self):
        from sgs_priors.networks import vggt

        # A camera at (1, 2, −3), turned by a quarter around y, and a wall at depth 4.
        turn = np.array([[0, 0, -1], [0, 1, 0], [1, 0, 0]], float)
        place = np.array([1, 2, -3.0])
        pose = np.concatenate([turn, -(turn @ place)[:, None]], 1)
        seen = []

        def network(images):
            seen.append(tuple(images.shape))
            _, n, _, h, w = images.shape
            trust = torch.linspace(1, 5, h * w).reshape(1, 1, h, w).expand(1, n, h, w)
            return {"pose_enc": torch.zeros(1, n, 9), "depth": torch.full((1, n, h, w, 1), 4.0), "depth_conf": trust}

        def decode(encoding, size):
            n, (h, w) = encoding.shape[1], size
            inner = torch.tensor([[100.0, 0, w / 2], [0, 200.0, h / 2], [0, 0, 1]])
            return torch.tensor(pose)[None, None].expand(1, n, 3, 4), inner[None, None].expand(1, n, 3, 3)

        with tempfile.TemporaryDirectory() as folder:
            photographs, scene = os.path.join(folder, "photographs"), os.path.join(folder, "scene")
            os.mkdir(photographs)
            for name in ("b.png", "a.png"):
                Image.fromarray(ramp(120, 160)).save(os.path.join(photographs, name))
            with contextlib.redirect_stderr(io.StringIO()):
                arguments = [photographs, "--weights", "none", "-o", scene, "--points", "500", "--device", "cpu"]
                self.assertEqual(vggt.main(arguments, (network, decode)), 0)
                self.assertEqual(vggt.main([folder, "--weights", "x", "-o", scene]), 1)
                self.assertFalse(os.path.exists(os.path.join(scene, "priors")))
                os.makedirs(os.path.join(scene, "priors"))
                priors = os.path.join(scene, "priors", "priors.json")
                with open(priors, "w", encoding="utf-8") as f:
                    f.write('{"normal": {"frame": "world"}}')
                self.assertEqual(vggt.main([*arguments, "--depth"], (network, decode)), 0)
            with open(priors, encoding="utf-8") as f:
                self.assertEqual(json.load(f), {"normal": {"frame": "world"}, "depth": {"meaning": "scale"}})
            for name in ("a", "b"):
                depth, sure = (np.load(os.path.join(scene, "priors", "depth", *more, name + ".npy"))
                               for more in ((), ("confidence",)))
                self.assertEqual((depth.shape, sure.shape, depth.dtype, sure.dtype), ((126, 154),) * 2 + (np.float32,) * 2)
                np.testing.assert_array_equal(depth, 4)
                np.testing.assert_allclose([sure.min(), sure.max()], [0, 0.8], rtol=1e-6)
            self.assertEqual(seen, [(1, 2, 3, 126, 154)] * 2)
            self.assertEqual(sorted(os.listdir(os.path.join(scene, "images"))), ["a.png", "b.png"])

            def lines(name):
                with open(os.path.join(scene, "sparse", "0", name), encoding="utf-8") as f:
                    return [line.split() for line in f if line.strip() and not line.startswith("#")]
            _, model, w, h, fx, fy, cx, cy = lines("cameras.txt")[0]
            self.assertEqual((model, w, h), ("PINHOLE", "160", "120"))
            found = [float(v) for v in (fx, fy, cx, cy)]
            np.testing.assert_allclose(found, [100 * 160 / 154, 200 * 120 / 126, 80, 60], rtol=1e-6)
            number, *numbers, camera, name = lines("images.txt")[0]
            self.assertEqual((number, camera, name), ("1", "1", "a.png"))
            q, t = np.array(numbers[:4], float), np.array(numbers[4:], float)
            np.testing.assert_allclose(_rotation(q), turn, atol=1e-6)
            np.testing.assert_allclose(-_rotation(q).T @ t, place, atol=1e-6)
            points = np.array(lines("points3D.txt"), float)
            self.assertEqual(len(points), 500)
            # Everything lies on the wall, 4 along the camera's axis, and projects to the color it has.
            local = points[:, 1:4] @ turn.T + pose[:, 3]
            np.testing.assert_allclose(local[:, 2], 4, atol=1e-4)
            x = local[:, 0] / local[:, 2] * 100 + 77
            np.testing.assert_allclose(points[:, 4], (x - 0.5) / 153 * 255, atol=4)
            # Half of the trust is the upper half of the image; the lowest 30 % are left out.
            y = local[:, 1] / local[:, 2] * 200 + 63
            self.assertGreater(y.min(), 0.29 * 126)


def _rotation(q):
    w, x, y, z = q
    return np.array([[1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                     [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                     [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]])


@unittest.skipIf(MISSING, MISSING)
class Pieces(unittest.TestCase):
    def test_regions_are_painted_from_large_to_small(self):
        from sgs_priors.networks import sam2

        def box(x0, y0, x1, y1):
            mask = np.zeros((10, 10), bool)
            mask[y0:y1, x0:x1] = True
            return mask
        chosen = [(0.9, box(0, 0, 10, 10)), (0.95, box(2, 2, 5, 5)), (0.85, box(2, 2, 5, 6)), (0.9, box(9, 9, 10, 10))]
        ids = sam2.paint(chosen, 10, 10)
        # The third is nearly the second, and less trusted.
        self.assertEqual((ids[0, 0], ids[3, 3], ids[5, 3], ids[9, 9]), (1, 2, 1, 3))
        self.assertEqual(sam2.paint([], 2, 3).tolist(), [[0, 0, 0], [0, 0, 0]])
        points = sam2.grid(48, 24)
        self.assertEqual((points.shape, points[0].tolist(), points[-1].tolist()), ((576, 2), [1.0, 0.5], [47.0, 23.5]))

    def test_masks_are_chosen_by_trust_stability_and_size(self):
        from sgs_priors.networks import sam2

        firm, vague = np.full((20, 20), -5.0), np.full((20, 20), -5.0)
        firm[:10] = 5
        vague[:10] = 0.5
        chosen = sam2.choose(np.stack([firm, firm, vague, np.full((20, 20), -5.0)]), np.array([0.9, 0.5, 0.9, 0.9]))
        self.assertEqual([(score, int(mask.sum())) for score, mask in chosen], [(0.9, 200)])

    def test_names_in_any_answer(self):
        from sgs_priors.networks.qwen_vl import names_in

        self.assertEqual(names_in('Sure: ["Wall", "floor lamp", "wall"] ok'), ["wall", "floor lamp"])
        self.assertEqual(names_in("The classes are: wall, Floor Lamp., sofa"), ["wall", "floor lamp", "sofa"])
        self.assertEqual(names_in("1. wall\n2) sofa\n- \"tv\"\n"), ["wall", "sofa", "tv"])
        self.assertEqual(names_in("[broken, \"list]"), ["broken", "list"])
        self.assertEqual(names_in(""), [])
        self.assertEqual(len(names_in(", ".join(f"thing {i}x" for i in range(99)))), 32)


@unittest.skipIf(MISSING, MISSING)
class Refusals(unittest.TestCase):
    def test_what_is_not_there_is_named(self):
        import importlib

        for module, words in (("stable_normal", "needs --code"), ("rgbx", "needs --code"), ("lseg", "needs --code"),
                              ("clip_text", "no saved model at /nowhere"), ("sam2", "no saved model at /nowhere"),
                              ("qwen_vl", "no saved model at /nowhere")):
            with self.assertRaisesRegex(Refusal, words):
                importlib.import_module(f"sgs_priors.networks.{module}").load("/nowhere", OPTIONS)


if __name__ == "__main__":
    unittest.main()
