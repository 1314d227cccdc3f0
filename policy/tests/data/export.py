"""Makes the two PyTorch files of this folder, and what PyTorch answers.

    pip install torch onnx onnxscript
    python policy/tests/data/export.py

This is also how to export a policy of your own: one input of 259 features, one
output of two actions, and all weights inside the file.
"""

import pathlib

import onnx
import torch
from torch import nn

FOLDER = pathlib.Path(__file__).parent

torch.manual_seed(0)
net = nn.Sequential(
    nn.Linear(259, 32), nn.ReLU(), nn.Linear(32, 32), nn.ReLU(), nn.Linear(32, 2), nn.Tanh()
)
net.eval()
example = (torch.zeros(1, 259),)
names = {"input_names": ["features"], "output_names": ["action"]}
torch.onnx.export(
    net, example, FOLDER / "torch_dynamo.onnx", dynamo=True, external_data=False, **names
)
torch.onnx.export(net, example, str(FOLDER / "torch_script.onnx"), dynamo=False, **names)

# A net that is no chain of layers: only ONNX Runtime takes it.
class Gated(nn.Module):
    def __init__(self):
        super().__init__()
        self.body = nn.Linear(259, 16)
        self.gate = nn.Linear(259, 16)
        self.head = nn.Linear(16, 2)

    def forward(self, features):
        hidden = torch.sigmoid(self.gate(features)) * torch.tanh(self.body(features))
        return torch.tanh(self.head(hidden))


gated = Gated().eval()
torch.onnx.export(
    gated, example, FOLDER / "torch_gated.onnx", dynamo=True, external_data=False, **names
)


# The new exporter writes down the source lines of this machine; nobody needs them.
for file in ["torch_dynamo.onnx", "torch_gated.onnx"]:
    model = onnx.load(FOLDER / file)
    for node in model.graph.node:
        del node.metadata_props[:]
    onnx.save(model, FOLDER / file)


def answers(module, file):
    with open(FOLDER / file, "w") as out, torch.no_grad():
        for step in [0.1, 0.37, 1.3]:
            features = (torch.arange(259, dtype=torch.float32) * step).sin().abs()
            steer, pedal = module(features[None])[0].tolist()
            print(step, steer, pedal, file=out)


answers(net, "expected.txt")
answers(gated, "expected_gated.txt")
