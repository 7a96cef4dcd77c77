"""Actions: what the nodes of a computational graph do."""

from cgtorch.actions.action import Action as Action
from cgtorch.actions.action_set import ActionSet as ActionSet
from cgtorch.actions.action_set import reward_actions as reward_actions
from cgtorch.actions.linear import DelayNN as DelayNN
from cgtorch.actions.linear import LinearNN as LinearNN
from cgtorch.actions.networks import BranchingNN as BranchingNN
from cgtorch.actions.networks import ContinuousNN as ContinuousNN
from cgtorch.actions.recurrent import RecurrentNN as RecurrentNN
from cgtorch.actions.registry import check_action as check_action
from cgtorch.actions.registry import resolve_actions as resolve_actions
from cgtorch.actions.routines import Perceive as Perceive
from cgtorch.actions.routines import Step as Step
from cgtorch.actions.routines import Test as Test
