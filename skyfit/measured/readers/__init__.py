from .channels import read_response as read_response
from .reading import read as read
from .tidy import read_directions as read_directions
