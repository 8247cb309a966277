from .aerial import AerialPerspective as AerialPerspective, constant_ambient as constant_ambient
from .inscatter import scattered_light as scattered_light
