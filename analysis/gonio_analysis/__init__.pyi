from gonio_analysis.report.notebook import change as change
from gonio_analysis.report.notebook import compare as compare
from gonio_analysis.report.notebook import consensus as consensus
from gonio_analysis.report.notebook import fit as fit
from gonio_analysis.report.notebook import polar as polar
from gonio_analysis.report.notebook import semilog as semilog
