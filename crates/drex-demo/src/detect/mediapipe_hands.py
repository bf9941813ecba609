"""Key points of one hand in a video, with MediaPipe, as drex-hand-demo/1.

    pip install "mediapipe==0.10.14" opencv-python-headless
    python3 mediapipe_hands.py VIDEO OUT.json [--mirrored] [--side right|left] [--confidence 0.5]

Later wheels of mediapipe (0.10.35 and after) have neither the models nor `solutions`. Key points are MediaPipe's world landmarks:
metres, about the hand's middle, axes along the camera's (x right, y down, z away). Frames without the hand get no key points.

MediaPipe takes every picture for a mirror image, as a selfie camera shows it. So in a video that is not mirrored it calls a right hand
"Left": `hand` in the output is the person's own hand, `mp_label` what MediaPipe called it. With --mirrored (the video is flipped) the
frames are flipped back first, so that both sides and key points are those of the hand that was there.

Exit status: 0 done, 3 a package is missing, 4 the video cannot be read, 5 no hand in any frame.
"""

import argparse
import json
import sys

NAMES = ["wrist", "thumb_cmc", "thumb_mcp", "thumb_ip", "thumb_tip"] + [
    f"{finger}_{joint}" for finger in ("index", "middle", "ring", "little") for joint in ("mcp", "pip", "dip", "tip")
]
PIP = 'pip install "mediapipe==0.10.14" opencv-python-headless'


def fail(status, message):
    print(message, file=sys.stderr)
    sys.exit(status)


def packages():
    """cv2 and mediapipe's Hands, or what to install."""
    try:
        import cv2
    except ImportError as error:
        fail(3, f"the Python package opencv-python-headless is missing ({error}); {PIP}")
    try:
        import mediapipe
    except ImportError as error:
        fail(3, f"the Python package mediapipe is missing ({error}); {PIP}")
    solutions = getattr(mediapipe, "solutions", None)
    if solutions is None or not hasattr(solutions, "hands"):
        version = getattr(mediapipe, "__version__", "unknown")
        fail(3, f"mediapipe {version} has no hand models of its own any more; {PIP}")
    return cv2, solutions.hands.Hands


def rounded(landmarks):
    return [[round(p.x, 6), round(p.y, 6), round(p.z, 6)] for p in landmarks.landmark]


def main():
    parser = argparse.ArgumentParser(description="key points of one hand in a video")
    parser.add_argument("video")
    parser.add_argument("out")
    parser.add_argument("--mirrored", action="store_true", help="the video is flipped left to right")
    parser.add_argument("--side", choices=["right", "left"], help="which hand, if both are seen; default: the one seen more often")
    parser.add_argument("--confidence", type=float, default=0.5)
    args = parser.parse_args()
    cv2, Hands = packages()

    video = cv2.VideoCapture(args.video)
    if not video.isOpened():
        fail(4, f"{args.video}: cannot be opened as a video")
    fps = video.get(cv2.CAP_PROP_FPS)
    fps = fps if fps == fps and fps > 0 else 30.0
    size = [int(video.get(cv2.CAP_PROP_FRAME_WIDTH)), int(video.get(cv2.CAP_PROP_FRAME_HEIGHT))]

    # Per frame, the detections: own side, label, score, world and image landmarks.
    frames = []
    with Hands(
        static_image_mode=False,
        max_num_hands=2,
        min_detection_confidence=args.confidence,
        min_tracking_confidence=args.confidence,
    ) as hands:
        while True:
            there, picture = video.read()
            if not there:
                break
            if args.mirrored:
                picture = cv2.flip(picture, 1)
            result = hands.process(cv2.cvtColor(picture, cv2.COLOR_BGR2RGB))
            found = []
            if result.multi_hand_world_landmarks:
                for handedness, world, image in zip(
                    result.multi_handedness, result.multi_hand_world_landmarks, result.multi_hand_landmarks
                ):
                    kind = handedness.classification[0]
                    own = {"Left": "right", "Right": "left"}.get(kind.label)
                    found.append((own, kind.label, kind.score, rounded(world), rounded(image)))
            frames.append(found)
    if not frames:
        fail(4, f"{args.video}: no frame can be read")

    seen = {side: sum(any(d[0] == side for d in found) for found in frames) for side in ("right", "left")}
    side = args.side or ("right" if seen["right"] >= seen["left"] else "left")
    if seen[side] == 0:
        which = f"{side} hand" if args.side else "hand"
        fail(5, f"{args.video}: no {which} found in {len(frames)} frames; film one hand, whole, well lit and sharp, or lower --confidence")

    out = []
    for i, found in enumerate(frames):
        frame = {"t": i / fps, "keypoints": []}
        own = [d for d in found if d[0] == side]
        if own:
            _, label, score, world, image = max(own, key=lambda d: d[2])
            frame.update(keypoints=world, image=image, score=round(score, 4), mp_label=label)
        out.append(frame)
    demo = {
        "format": "drex-hand-demo/1",
        "hand": side,
        "units": "m",
        "joint_names": NAMES,
        "source": f"mediapipe world landmarks of {args.video}",
        "fps": fps,
        "image_size": size,
        "frame": "camera-aligned, origin at the hand's geometric centre, x right y down z away",
        "frames": out,
    }
    with open(args.out, "w") as file:
        json.dump(demo, file)


if __name__ == "__main__":
    main()
