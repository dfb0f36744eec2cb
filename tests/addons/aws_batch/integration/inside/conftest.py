from tests.integration.execution.conftest import image_of_all_containers

__all__ = ["image_of_all_containers"]
