#!/usr/bin/env python3
"""The simulation application: what the robot's cameras would see of a pattern that is moved.

Subscribes to ``/pattern/pose``, the pose of the pattern's model in the world. Publishes the images and the
intrinsics of every camera, all of one moment, and the frames of the robot on ``/tf`` and ``/tf_static``.
The images are those of Calibration CI's own renderer; Gazebo could stand in its place.
"""

from pathlib import Path
from zlib import crc32

import numpy as np
import rospy
from geometry_msgs.msg import PoseStamped, TransformStamped
from sensor_msgs.msg import CameraInfo, Image
from tf2_msgs.msg import TFMessage

from calibration.engine.geometry.rotations import to_quaternion
from calibration.robot.simulation.kinematics import place, stream
from calibration.robot.simulation.motion import Motion
from calibration.robot.simulation.system import read_system

RATE = 10.0
"""Images of each camera in a second."""


class Simulation:
    """The cameras and the pattern of one system."""

    def __init__(self, folder, seed):
        self.system = read_system(Path(folder))
        self.seed = seed
        self.pose = None
        """The last one that was asked for: position and quaternion."""
        self.rendered = None
        """(pose, images by camera): a scene that does not move is drawn once."""
        self.images, self.infos = {}, {}
        for name, sensor in self.system.configuration.sensors.items():
            self.images[name] = rospy.Publisher(sensor.topic_name, Image, queue_size=1)
            topic = sensor.topic_name.rpartition("/")[0] + "/camera_info"
            self.infos[name] = rospy.Publisher(topic, CameraInfo, queue_size=1)
        self.tf = rospy.Publisher("/tf", TFMessage, queue_size=10)
        self.tf_static = rospy.Publisher("/tf_static", TFMessage, queue_size=1, latch=True)
        self.tf_static.publish(self.transforms(rospy.Time.now(), movable=False))
        rospy.Subscriber("/pattern/pose", PoseStamped, self.move, queue_size=1)

    def move(self, message):
        """Take the pose that the pattern is to have."""
        world = self.system.configuration.world_link
        if message.header.frame_id != world:
            rospy.logerr("/pattern/pose: found a pose in frame '%s', expected '%s'", message.header.frame_id, world)
            return
        p, q = message.pose.position, message.pose.orientation
        self.pose = (p.x, p.y, p.z), (q.x, q.y, q.z, q.w)

    def step(self):
        """Publish what the cameras see now."""
        stamp, pose = rospy.Time.now(), self.pose  # in this order: what is seen is never older than its stamp
        if self.rendered is None or self.rendered[0] != pose:
            self.rendered = pose, self.render(pose)
        movable = self.transforms(stamp, movable=True)
        if movable.transforms:
            self.tf.publish(movable)
        for name, image in self.rendered[1].items():
            self.infos[name].publish(self.camera_info(name, stamp))
            self.images[name].publish(self.image_message(name, image, stamp))

    def render(self, pose):
        """What every camera sees; the same for the same pose, its noise too."""
        position, orientation = pose or ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
        motion = Motion(np.array([position]), np.array([orientation]), {})
        placement = place(self.system, motion)
        # before the first pose there is no pattern
        boards = self.system.boards({name: T[0] for name, T in placement.patterns.items()}) if pose else []
        key = crc32(repr(pose).encode())
        return {
            name: camera.render(placement.sensors[name][0], self.system.scene, boards, stream(self.seed, key, name))
            for name, camera in self.system.cameras.items()
        }

    def transforms(self, stamp, movable):
        """The joints of the robot that move, or those that do not; all are where they rest."""
        message = TFMessage()
        positions = self.system.robot.transforms({})
        for joint in self.system.robot.joints:
            if joint.is_movable == movable:
                T = positions[joint.edge][0]
                entry = TransformStamped()
                entry.header.stamp, entry.header.frame_id, entry.child_frame_id = stamp, joint.parent, joint.child
                t, r = entry.transform.translation, entry.transform.rotation
                t.x, t.y, t.z = T[:3, 3]
                r.x, r.y, r.z, r.w = to_quaternion(T[:3, :3])
                message.transforms.append(entry)
        return message

    def image_message(self, name, image, stamp):
        """A camera's image."""
        message = Image(encoding="bgr8", is_bigendian=0, data=image.tobytes())
        message.height, message.width, message.step = image.shape[0], image.shape[1], 3 * image.shape[1]
        message.header.stamp, message.header.frame_id = stamp, self.system.configuration.sensors[name].link
        return message

    def camera_info(self, name, stamp):
        """A camera's intrinsics."""
        camera = self.system.cameras[name].camera
        d, (fx, fy, cx, cy) = camera.distortion, (camera.fx, camera.fy, camera.cx, camera.cy)
        message = CameraInfo(height=camera.height, width=camera.width, distortion_model="plumb_bob")
        message.header.stamp, message.header.frame_id = stamp, self.system.configuration.sensors[name].link
        message.D = [d.k1, d.k2, d.p1, d.p2, d.k3]
        message.K = [fx, 0, cx, 0, fy, cy, 0, 0, 1]
        message.R = [1, 0, 0, 0, 1, 0, 0, 0, 1]
        message.P = [fx, 0, cx, 0, 0, fy, cy, 0, 0, 0, 1, 0]
        return message


def main():
    """Simulate until ROS shuts down."""
    rospy.init_node("simulation")
    simulation = Simulation(rospy.get_param("~system"), rospy.get_param("~seed", 1))
    rate = rospy.Rate(RATE)
    simulation.step()
    rospy.loginfo("simulation ready: %s", ", ".join(simulation.images))
    while not rospy.is_shutdown():
        simulation.step()
        try:
            rate.sleep()
        except rospy.ROSInterruptException:
            break


if __name__ == "__main__":
    main()
