from .camera import Camera as Camera
from .picture import Image as Image, Lamp as Lamp
from .render import render as render
