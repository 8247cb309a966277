from .air import air_to as air_to
from .camera import Camera as Camera
from .luts import write_luts as write_luts
from .panorama import Panorama as Panorama, read_panorama as read_panorama
from .picture import Image as Image, Lamp as Lamp
from .render import render as render
