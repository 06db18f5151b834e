from gonio_analysis.notebook import change as change
from gonio_analysis.notebook import compare as compare
from gonio_analysis.notebook import consensus as consensus
from gonio_analysis.notebook import fit as fit
from gonio_analysis.notebook import polar as polar
from gonio_analysis.notebook import semilog as semilog
