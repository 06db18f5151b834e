from gonio.instrument import apparent_brdf as apparent_brdf
from gonio.lab.by_hand.manual_rig import open_rig as open_rig
from gonio.measurement import read as read
from gonio.measurement import write as write
from gonio.models import Blinn as Blinn
from gonio.models import CookTorrance as CookTorrance
from gonio.models import HeTorrance as HeTorrance
from gonio.models import Lambert as Lambert
from gonio.models import OrenNayar as OrenNayar
from gonio.models import Phong as Phong
from gonio.models import Sum as Sum

__version__: str
