"""The markers of a ChArUco board, as OpenCV knows them."""

import cv2

from verify.board import Board

DICTIONARIES = tuple(  # OpenCV spells some twice, once in small letters
    name for name in dir(cv2.aruco) if name.startswith("DICT_") and name.isupper()
)


def dictionary(name: str) -> cv2.aruco.Dictionary:
    """Look up one of `DICTIONARIES`."""
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))


def capacity(name: str) -> int:
    """Count the markers of a dictionary."""
    return len(dictionary(name).bytesList)


def needed(board: Board) -> int:
    """Count the white squares, each of which holds a marker."""
    return (board.columns + 1) * (board.rows + 1) // 2


def charuco(board: Board) -> cv2.aruco.CharucoBoard:
    """Build OpenCV's description of a board that has markers; its corners are in `points`' order.

    Raises:
        ValueError: the board is a plain one.
    """
    if board.markers is None or board.marker is None:
        raise ValueError("a plain chessboard has no markers")
    squares = (board.columns + 1, board.rows + 1)
    return cv2.aruco.CharucoBoard(squares, board.square, board.marker, dictionary(board.markers))
