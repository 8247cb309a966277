from .camera import Camera as Camera
from .panorama import Panorama as Panorama, read_panorama as read_panorama
from .picture import Image as Image, Lamp as Lamp
from .render import render as render
