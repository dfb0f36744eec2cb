"""Runs in a container: a ROS 1 system whose services answer in every way that a player may meet."""

import os
import time

import rospy
from geometry_msgs.msg import PoseStamped
from std_srvs.srv import Empty, EmptyResponse, SetBool, Trigger, TriggerResponse

seen = []


def save(_request):
    """Tell where the pattern is: that is what would be saved; nothing where it is low."""
    pose = seen[-1]
    p, q = pose.pose.position, pose.pose.orientation
    return TriggerResponse(p.z > 0, f"{pose.header.frame_id} {p.x} {p.y} {p.z} {q.x} {q.y} {q.z} {q.w}")


def fail(_request):
    """Raise what the player has to tell."""
    raise RuntimeError("the disk is full")


def hang(_request):
    """Answer long after anybody waits."""
    time.sleep(600)


def end(_message):
    """Die as a node does that runs out of memory."""
    os._exit(1)


rospy.init_node(os.environ.get("NODE", "system"))
rospy.Subscriber("/pattern/pose", PoseStamped, seen.append)
if rospy.get_name() == "/system":
    rospy.Service("/save", Trigger, save)
    rospy.Service("/refuse", Trigger, lambda _: TriggerResponse(False, "nothing seen\nat all"))
    rospy.Service("/fail", Trigger, fail)
    rospy.Service("/hang", Trigger, hang)
    rospy.Service("/empty", Empty, lambda _: EmptyResponse())
    rospy.Service("/wants", SetBool, fail)
else:
    rospy.Subscriber("/mortal/pose", PoseStamped, end)
    rospy.Service("/end", Trigger, end)
print("ready", flush=True)
rospy.spin()
