"""AlpaSim's sensor simulator as a gRPC service: the calls of its `SensorsimService`."""

from typing import Any

from gsrain_engine.simulation.serving.grpc_server import Method, RenderServer
from gsrain_engine.simulation.serving.scenes import RequestError

from .messages import API_VERSION, SERVICE, calls, message
from .simulator import Simulator

_MAX_BATCH = 64  # pictures or lidar turns of one call


class SensorsimServer(RenderServer[Simulator]):
    """A running server of AlpaSim's `SensorsimService`."""

    def services(self) -> dict[str, dict[str, tuple[Any, Method]]]:
        methods = self._methods()
        return {SERVICE: {name: (call.request, methods[name]) for name, call in calls(SERVICE).items()}}

    def subject(self, request: Any) -> str:
        rows = [*getattr(request, "rgb_requests", ()), *getattr(request, "lidar_requests", ())]
        rows += [item.request for item in getattr(request, "items", ())]
        return f"{len(rows)} of {super().subject(rows[0])}" if rows else super().subject(request)

    def _methods(self) -> dict[str, Method]:
        simulator = self.scenes

        def rgb(request: Any, context: Any) -> Any:
            data = self.draw(lambda is_active: simulator.picture(request, is_active), context)
            return message("RGBRenderReturn")(image_bytes=data)

        def lidar(request: Any, context: Any) -> Any:
            return self.draw(lambda _: simulator.lidar(request), context)

        def aggregated(request: Any, context: Any) -> Any:
            self._check_batch(len(request.rgb_requests) + len(request.lidar_requests))
            answer = message("AggregatedRenderReturn")()
            for each in request.rgb_requests:
                self.check_answer_bytes(answer.ByteSize())
                answer.rgb_returns.append(rgb(each, context))
            for each in request.lidar_requests:
                self.check_answer_bytes(answer.ByteSize())
                answer.lidar_returns.append(lidar(each, context))
            return answer

        def batch(request: Any, context: Any) -> Any:
            self._check_batch(len(request.items))
            answer = message("BatchRGBRenderReturn")()
            for each in request.items:
                self.check_answer_bytes(answer.ByteSize())
                item = answer.items.add(camera_name=each.camera_name)
                try:
                    item.result.CopyFrom(rgb(each.request, context))
                    item.success = True
                except RequestError as error:
                    if error.status == "CANCELLED":
                        raise
                    item.error_message = f"{error.status}: {error.text}"
            return answer

        def version(request: Any, context: Any) -> Any:
            found = message("common.VersionId")(version_id=f"gsrain {self.version}", git_hash="")
            api = found.grpc_api_version
            api.major, api.minor, api.patch = API_VERSION
            return found

        def available(request: Any, context: Any) -> Any:
            return message("common.AvailableScenesReturn")(scene_ids=[*simulator.scenes])

        def loaded(request: Any, context: Any) -> Any:
            answer = message("LoadedScenesReturn")(loaded_instance_capacity=len(simulator.scenes))
            for name in simulator.scenes:
                answer.scenes.add(scene_id=name, loaded_instance_count=1, reusable_instance_count=1)
            return answer

        return {
            "render_rgb": rgb,
            "render_lidar": lidar,
            "render_aggregated": aggregated,
            "batch_render_rgb": batch,
            "get_version": version,
            "get_available_scenes": available,
            "get_loaded_scenes": loaded,
            "get_available_cameras": lambda request, context: simulator.cameras(request),
            "get_available_trajectories": lambda request, context: simulator.trajectories(request),
            "get_available_ego_masks": lambda request, context: message("AvailableEgoMasksReturn")(),
        }

    def _check_batch(self, count: int) -> None:
        if count > _MAX_BATCH:
            raise RequestError("INVALID_ARGUMENT", f"{count} pictures in one call, at most {_MAX_BATCH} are made")
