"""Where to look for the LEDs of a marker whose pose is predicted."""

import numpy as np

from verify.identification import Prediction
from verify.marker import Marker
from verify.records import Array, Image
from verify.rig import Camera
from verify.window_kernel import boxes_about

# A spot's surroundings: its own radius several times over, for the background that is fitted.
MARGIN_PX = 14.0


def windows(
    marker: Marker, camera: Camera, pan: float, prediction: Prediction, image: Image
) -> Array:
    """Where to look for each LED, (n, 4) px: x0, y0, x1, y1, overlapping ones merged.

    Args:
        marker: the LEDs.
        camera: who sees them.
        pan: rad, reading of its base.
        prediction: of the flange's pose in the rig.
        image: the picture that is to be searched.
    """
    doubt = 2 * prediction.position_uncertainty, 2 * prediction.rotation_uncertainty
    boxes = np.empty((len(marker), 4))
    count = boxes_about(
        camera.camera_T_rig(pan) @ prediction.rig_T_flange,
        np.ascontiguousarray(marker.leds),
        (camera.matrix, camera.distortion),
        (MARGIN_PX, marker.led_diameter, *doubt),
        (image.shape[1], image.shape[0]),
        boxes,
    )
    return boxes[:count]
