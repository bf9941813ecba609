"""Hands of a video with HaMeR, as an .npz that drex reads.

Runs inside HaMeR's own environment, in the folder of its repository (github.com/geopavlakos/hamer; its weights and the MANO model need a
registration of yours and are for non-commercial use; ViTPose and detectron2 as its readme says):

    cd hamer && python hamer_export.py VIDEO OUT.npz [--side right|left]

Writes one row per detected hand: frame, right, pred_keypoints_3d, pred_cam, box_center, box_size, img_size, global_orient, hand_pose,
betas, score, and fps. All are HaMeR's raw values: left hands are still the mirrored right ones that HaMeR predicts; the reader turns
them around and moves them from the crop into the picture.

Exit status: 0 done, 3 a package is missing, 4 the video cannot be read, 5 no hand in any frame.
"""

import argparse
import sys


def fail(status, message):
    print(message, file=sys.stderr)
    sys.exit(status)


try:
    import cv2
    import numpy as np
    import torch
    from hamer.configs import CACHE_DIR_HAMER
    from hamer.datasets.vitdet_dataset import ViTDetDataset
    from hamer.models import DEFAULT_CHECKPOINT, download_models, load_hamer
    from hamer.utils import recursive_to
    from vitpose_model import ViTPoseModel
except ImportError as error:
    fail(3, f"{error}; run this in HaMeR's environment, in the folder of its repository")

# A hand needs this many of its 21 image points above this confidence.
LEAST_POINTS, LEAST_CONFIDENCE = 4, 0.5
# Arrays of each detection that are kept as HaMeR gives them.
OUTPUTS = ["pred_keypoints_3d", "pred_cam"]
MANO = ["global_orient", "hand_pose", "betas"]
CROP = ["box_center", "box_size", "img_size", "right"]


def hand_boxes(pose_model, picture):
    """Boxes of the hands that ViTPose sees in an RGB picture: (box, right, score)."""
    height, width = picture.shape[:2]
    # The whole picture is taken for one person: recordings for this show the hand large.
    people = pose_model.predict_pose(picture, [np.array([[0.0, 0.0, width, height, 1.0]])])
    boxes = []
    for person in people:
        points = person["keypoints"]
        for right, hand in ((0, points[-42:-21]), (1, points[-21:])):
            sure = hand[hand[:, 2] > LEAST_CONFIDENCE]
            if len(sure) >= LEAST_POINTS:
                box = np.concatenate([sure[:, :2].min(0), sure[:, :2].max(0)])
                boxes.append((box, right, float(sure[:, 2].mean())))
    return boxes


def main():
    parser = argparse.ArgumentParser(description="hands of a video with HaMeR")
    parser.add_argument("video")
    parser.add_argument("out")
    parser.add_argument("--side", choices=["right", "left"])
    parser.add_argument("--checkpoint", default=DEFAULT_CHECKPOINT)
    args = parser.parse_args()
    video = cv2.VideoCapture(args.video)
    if not video.isOpened():
        fail(4, f"{args.video}: cannot be opened as a video")
    fps = video.get(cv2.CAP_PROP_FPS) or 30.0

    device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
    download_models(CACHE_DIR_HAMER)
    model, config = load_hamer(args.checkpoint)
    model = model.to(device).eval()
    pose_model = ViTPoseModel(device)

    rows = {name: [] for name in ["frame", "score"] + OUTPUTS + MANO + CROP}
    count = 0
    while True:
        there, picture = video.read()
        if not there:
            break
        found = hand_boxes(pose_model, picture[:, :, ::-1].copy())
        if args.side:
            found = [f for f in found if f[1] == (args.side == "right")]
        if found:
            boxes, rights, scores = (np.array(column) for column in zip(*found))
            data = ViTDetDataset(config, picture, boxes, rights, rescale_factor=2.0)
            for k, batch in enumerate(torch.utils.data.DataLoader(data, batch_size=1)):
                batch = recursive_to(batch, device)
                with torch.no_grad():
                    out = model(batch)
                rows["frame"].append(count)
                rows["score"].append(scores[k])
                for name in OUTPUTS:
                    rows[name].append(out[name][0].cpu().numpy())
                for name in MANO:
                    rows[name].append(out["pred_mano_params"][name][0].cpu().numpy())
                for name in CROP:
                    rows[name].append(np.asarray(batch[name][0].cpu()))
        count += 1
    if not rows["frame"]:
        fail(5, f"{args.video}: no hand found in {count} frames")
    np.savez_compressed(args.out, fps=fps, **{name: np.array(values) for name, values in rows.items()})


if __name__ == "__main__":
    main()
