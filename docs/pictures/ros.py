"""Makes ros-compared.png: a bag of `presight replay --mcap` as Rerun shows it, without a window.

    presight replay drive.mcap --map corridor.glb --init unknown --mcap compared.mcap
    python docs/pictures/ros.py compared.mcap corridor.glb docs/pictures/ros-compared.png

Needs rerun-sdk 0.41, Pillow, and a Vulkan driver, such as Mesa's lavapipe. Rerun draws no visualization_msgs, so the model is given.
"""

import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from PIL import Image
from rerun.experimental import ViewerClient

bag, model, picture = sys.argv[1:]
PORT = 9897


def points(color, radius):
    return rr.Points3D.from_fields(colors=[color], radii=[rr.Radius.ui_points(radius)])


with tempfile.TemporaryDirectory() as folder:
    recording = str(Path(folder) / "bag.rrd")
    convert = ["rerun", "mcap", "convert", bag, "--application-id", "presight", "--recording-id", "bag", "-o", recording]
    subprocess.run(convert, check=True, capture_output=True)
    viewer = ViewerClient.spawn(headless=True, port=PORT)
    url = f"rerun+http://127.0.0.1:{PORT}/proxy"
    rr.init("presight", recording_id="bag")
    rr.connect_grpc(url)
    rr.log_file_from_path(recording)
    # glTF has y up.
    upright = rr.Transform3D(mat3x3=np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]]), parent_frame="map", child_frame="model")
    rr.log("model", upright, rr.CoordinateFrame("model"), rr.Asset3D(path=model), static=True)
    view = rrb.Spatial3DView(
        name="should and is",
        origin="/",
        contents=["/presight/predicted/points", "/presight/verdict", "/model", "/tf", "/tf_static"],
        overrides={"/presight/predicted/points": points([40, 120, 255], 5.0), "/presight/verdict": points([255, 120, 0], 2.5)},
        eye_controls=rrb.EyeControls3D(position=[16.5, -16.5, 13.0], look_target=[17.0, -10.8, 0.0], eye_up=[0.0, 0.0, 1.0]),
        spatial_information=rrb.SpatialInformation(target_frame="map"),
    )
    rr.send_blueprint(rrb.Blueprint(view, rrb.TimePanel(timeline="message_log_time"), collapse_panels=True))
    time.sleep(5)
    viewer.set_time("message_log_time", timestamp=1137772799.0, play_state="paused")
    time.sleep(3)
    viewer.save_screenshot(str(Path(folder) / "whole.png"))
    viewer.quit()
    part = Image.open(Path(folder) / "whole.png").convert("RGB").crop((520, 240, 1420, 620))
    part.quantize(256, method=Image.Quantize.MAXCOVERAGE).save(picture, optimize=True)
