"""A network camera: MJPEG over HTTP, reproducible pictures."""

import http.server
import threading
import time

import cv2
import numpy as np

from verify.core.records import Image


def picture(number: int, colour: bool = True) -> Image:
    """A picture with its number in it."""
    shape = (48, 64, 3) if colour else (48, 64)
    image = np.full(shape, number % 200, np.uint8)
    cv2.putText(image, str(number), (2, 30), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (255, 255, 255))
    return image


def jpeg(number: int, colour: bool = True) -> bytes:
    """The same as a JPEG."""
    return cv2.imencode(".jpg", picture(number, colour))[1].tobytes()


class CameraServer:
    """Serves pictures at 30 Hz until it is closed; `port` 0 takes any."""

    def __init__(self, port: int = 0, damaged: int | None = None) -> None:
        self.stopping = threading.Event()
        stopping = self.stopping

        class Handler(http.server.BaseHTTPRequestHandler):
            def log_message(self, format: str, *arguments: object) -> None:  # noqa: A002
                pass

            def do_GET(self) -> None:
                self.send_response(200)
                kind = "multipart/x-mixed-replace; boundary=frame"
                self.send_header("Content-Type", kind)
                self.end_headers()
                number = 0
                try:
                    while not stopping.is_set():
                        data = jpeg(number)
                        if number == damaged:
                            data = data[:4] + bytes(len(data) - 4)
                        head = f"--frame\r\nContent-Type: image/jpeg\r\nContent-Length: {len(data)}"
                        self.wfile.write(head.encode() + b"\r\n\r\n" + data + b"\r\n")
                        number += 1
                        time.sleep(1 / 30)
                except OSError:
                    pass

        self._server = http.server.ThreadingHTTPServer(("127.0.0.1", port), Handler)
        self._server.daemon_threads = True
        self.port = int(self._server.server_address[1])
        threading.Thread(target=self._server.serve_forever, daemon=True).start()

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.port}/video"

    def close(self) -> None:
        self.stopping.set()
        self._server.shutdown()
        self._server.server_close()
