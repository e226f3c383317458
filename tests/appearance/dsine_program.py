"""A folder like DSINE's program: the same files, names and calls, without its network."""

from pathlib import Path

_ENCODER = """
import torch.nn as nn
import geffnet

class Encoder(nn.Module):
    def __init__(self, B=5, pretrained=True):
        super().__init__()
        self.original_model = geffnet.create_model("tf_efficientnet_b%s_ap" % B, pretrained=pretrained)
"""

_COORDINATES = """
import torch

def get_pixel_coords(h, w):
    y, x = torch.meshgrid(torch.arange(h) + 0.5, torch.arange(w) + 0.5, indexing="ij")
    return torch.stack([x, y, torch.ones_like(x)])[None]
"""

_FORWARD = """
    def forward(self, img, intrins=None, mode="train"):
        intrins[:, 0, 2] += 0.5
        intrins[:, 1, 2] += 0.5
        height, width = img.shape[2:]
        assert height % 32 == 0 and width % 32 == 0
        ray = self.pixel_coords[:, :, :height, :width].clone()
        ray[:, 0] = (ray[:, 0] - intrins[:, 0, 2]) / intrins[:, 0, 0]
        ray[:, 1] = (ray[:, 1] - intrins[:, 1, 2]) / intrins[:, 1, 1]
        ray = torch.nn.functional.normalize(ray * self.gain.abs(), dim=1)
        return [torch.zeros_like(ray), EXTRA]
"""

_NEW = """
import torch
import torch.nn as nn
from models.conv_encoder_decoder.submodules import Encoder
from models.dsine.submodules import get_pixel_coords
from utils.rotation import turned

class DSINE_NAME(nn.Module):
    def __init__(self, args):
        super().__init__()
        assert args.NRN_ray_relu and args.NNET_decoder_NF == 2048
        self.encoder = Encoder(B=args.NNET_encoder_B, pretrained=True)
        self.pixel_coords = get_pixel_coords(h=2000, w=2000).to(0)
        self.gain = nn.Parameter(torch.ones(1))
"""


def write_program(folder: Path, is_old: bool = False) -> Path:
    """Write it as it is now, or as it was first."""
    forward = _FORWARD.replace("EXTRA", "ray")
    files = {"utils/rotation.py": "def turned(): ...\n"}
    if is_old:
        files["models/submodules.py"] = _ENCODER + _COORDINATES
        old = _NEW.replace("_NAME", "").replace("conv_encoder_decoder.", "").replace("dsine.", "")
        old = old.replace("(self, args)", "(self)").replace("args.NNET_encoder_B", "5").replace(".to(0)", "")
        files["models/dsine.py"] = "".join(line for line in old.splitlines(True) if "assert" not in line) + forward
    else:
        files["models/conv_encoder_decoder/submodules.py"] = _ENCODER
        files["models/dsine/submodules.py"] = _COORDINATES
        files["models/dsine/v02.py"] = _NEW.replace("NAME", "v02") + forward
        uncertain = _FORWARD.replace("EXTRA", "torch.cat([ray, ray[:, :1] + 9], dim=1)")
        head = "        self.kappa_head = nn.Conv2d(1, 1, 1)\n"
        files["models/dsine/v02_kappa.py"] = _NEW.replace("NAME", "v02_kappa") + head + uncertain
    for name, text in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)
    return folder
