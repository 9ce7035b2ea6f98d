"""Which effects a scene calls for, and why."""

from .explain import explain as explain
from .needs import Reason as Reason
from .needs import plan_for as plan_for
