"""All of the rules."""

from tests.service.machine.adoptions import Adoptions
from tests.service.machine.hooks import Hooks
from tests.service.machine.journeys import Journeys
from tests.service.machine.keys import Keys
from tests.service.machine.models import Models
from tests.service.machine.moments import Moments
from tests.service.machine.reads import Reads
from tests.service.machine.streams import Streams


class Whole(Keys, Reads, Moments, Streams, Hooks, Journeys, Adoptions, Models):
    """A rotor's whole life, over every route."""
