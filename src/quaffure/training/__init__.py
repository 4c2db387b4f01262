"""Training of the decoder, of the groom code and of GroomGen: one loop, three recipes."""

from typing import TYPE_CHECKING

from quaffure._lazy import lazy_exports

if TYPE_CHECKING:
    from quaffure.training.averaged_adam import AveragedAdam
    from quaffure.training.distributed import Worker
    from quaffure.training.groom_samples import ProceduralGroom
    from quaffure.training.groomgen_data import DrapeFolder, random_head_rotation
    from quaffure.training.loop import Training, train
    from quaffure.training.pose_sampler import PoseSampler
    from quaffure.training.run_folder import RunFolder
    from quaffure.training.train_config import TrainConfig
    from quaffure.training.train_decoder import DecoderRecipe, GroomedBody
    from quaffure.training.train_groom_code import GroomCodeConfig, GroomCodeRecipe
    from quaffure.training.train_groomgen import GroomGenConfig, GroomGenRecipe
    from quaffure.training.validation import Validation, loss_unit, prior_validation, validation_metrics

__all__, __getattr__, __dir__ = lazy_exports(__name__)
