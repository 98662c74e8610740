"""Import of OpenCV, which several distributions provide, so that none is a dependency."""

try:
    import cv2 as cv2
except ModuleNotFoundError as error:
    hint = "OpenCV 4.12 or newer is needed: pip install opencv-python-headless"
    raise ModuleNotFoundError(hint, name="cv2") from error
