"""Reports of a run: live progress, TensorBoard, pictures, tables and a page."""

from cgtorch.report.graph_picture import draw_skill as draw_skill
from cgtorch.report.messages import final_table as final_table
from cgtorch.report.progress import ProgressDisplay as ProgressDisplay
from cgtorch.report.tensorboard import TensorBoardWatch as TensorBoardWatch
