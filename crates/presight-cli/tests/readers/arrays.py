"""Every .npy of an output is the channel of that name in the EXR file, bit for bit."""
import sys

import numpy
import OpenEXR

channels = OpenEXR.File(sys.argv[1]).channels()
assert sorted(channels) == ["cos_incidence", "echo", "object_id", "polygon_id", "range"], channels.keys()
for name, channel in channels.items():
    array = numpy.load(f"{name}.npy")
    assert array.dtype.str == ("<u4" if name.endswith("_id") else "<f4"), (name, array.dtype)
    assert array.flags["C_CONTIGUOUS"] and array.shape == channel.pixels.shape == (512, 512), (name, array.shape)
    assert array.tobytes() == channel.pixels.tobytes(), name

rays = numpy.load("rays.npy")
assert rays.dtype.str == "<f8" and rays.shape == (512, 512, 3), (rays.dtype, rays.shape)
assert numpy.allclose(numpy.linalg.norm(rays, axis=2), 1, atol=1e-15)
assert rays[0, 0, 1] > 0 > rays[511, 511, 1] and rays[0, 0, 2] > 0 > rays[511, 511, 2], "left and up come first"
