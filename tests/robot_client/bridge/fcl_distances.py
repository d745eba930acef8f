"""Distances of a URDF's meshes by FCL, for clearance.py: reads a JSON line of bridge_clearance and adds to each of its
poses fcl_itself [m], 0 where links that are watched touch, fcl_table [m], the height of the lowest corner beyond the
first link, and fcl_touching, pairs of links that touch.

usage: fcl_distances.py URDF JOINT,JOINT,... IN.json OUT.json [FOLDER OF PACKAGES]...
"""
import json
import os
import sys
import xml.etree.ElementTree as ET

import fcl
import numpy as np
import trimesh
from trimesh.transformations import euler_matrix, rotation_matrix


def numbers(element, attribute, absent):
    text = None if element is None else element.get(attribute)
    return [float(word) for word in text.split()] if text else absent


def pose_of(origin):
    matrix = euler_matrix(*numbers(origin, "rpy", [0, 0, 0]), "sxyz")
    matrix[:3, 3] = numbers(origin, "xyz", [0, 0, 0])
    return matrix


def find(name, urdf, packages):
    if not name.startswith("package://"):
        return os.path.join(os.path.dirname(urdf), name)
    package, inside = name[len("package://"):].split("/", 1)
    folder, folders = os.path.dirname(os.path.abspath(urdf)), list(packages)
    while folder != "/":
        folders.append(folder)
        folder = os.path.dirname(folder)
    places = [os.path.join(f, *rest) for f in folders for rest in ((package, inside), (inside,))]
    return next(place for place in places if os.path.exists(place))


def mesh_of(shape, urdf, packages):
    if shape.tag == "mesh":
        mesh = trimesh.load(find(shape.get("filename"), urdf, packages), force="mesh")
        return mesh.vertices * np.array(numbers(shape, "scale", [1, 1, 1])), mesh.faces
    if shape.tag == "box":
        mesh = trimesh.creation.box(numbers(shape, "size", None))
    elif shape.tag == "sphere":
        mesh = trimesh.creation.icosphere(subdivisions=4, radius=float(shape.get("radius")))
    elif shape.tag == "capsule":
        mesh = trimesh.creation.capsule(radius=float(shape.get("radius")), height=float(shape.get("length")), count=[64, 32])
    else:
        mesh = trimesh.creation.cylinder(radius=float(shape.get("radius")), height=float(shape.get("length")), sections=64)
    return mesh.vertices, mesh.faces


def read(urdf, joints, packages):
    """(link that a joint moves, -1: the base; joints on the way; pose on the last link; corners; FCL's object)"""
    root = ET.parse(urdf).getroot()
    above = {joint.find("child").get("link"): joint for joint in root.findall("joint")}
    bodies = []
    for link in root.findall("link"):
        way, name = [], link.get("name")
        while name in above:
            way.insert(0, above[name])
            name = above[name].find("parent").get("link")
        moving = [joint.get("name") for joint in way if joint.get("name") in joints]
        owner = joints.index(moving[-1]) if moving else -1
        for shown in link.findall("collision") or link.findall("visual"):
            corners, faces = mesh_of(shown.find("geometry")[0], urdf, packages)
            model = fcl.BVHModel()
            model.beginModel(len(corners), len(faces))
            model.addSubModel(corners, faces)
            model.endModel()
            bodies.append((owner, way, pose_of(shown.find("origin")), corners,
                           fcl.CollisionObject(model, fcl.Transform())))
    return bodies


def main():
    urdf, joints, source, target = sys.argv[1], sys.argv[2].split(","), sys.argv[3], sys.argv[4]
    with open(source, encoding="utf-8") as file:
        ours = json.load(file)
    bodies = read(urdf, joints, sys.argv[5:])
    watched = {tuple(pair) for pair in ours["watched"]}
    for row in ours["poses"]:
        angles = dict(zip(joints, row["q"]))
        lowest = np.inf
        for owner, way, on_link, corners, body in bodies:
            pose = np.eye(4)
            for joint in way:
                pose = pose @ pose_of(joint.find("origin"))
                if joint.get("name") in angles:
                    axis = numbers(joint.find("axis"), "xyz", [1, 0, 0])
                    pose = pose @ rotation_matrix(angles[joint.get("name")], axis)
            pose = pose @ on_link
            body.setTransform(fcl.Transform(pose[:3, :3], pose[:3, 3]))
            if owner >= 1:
                lowest = min(lowest, (corners @ pose[2, :3]).min() + pose[2, 3])
        itself, touching = np.inf, set()
        for first, *_, a in bodies:
            for second, *_, b in bodies:
                if first + 2 > second:
                    continue
                distance = max(0, fcl.distance(a, b, fcl.DistanceRequest(), fcl.DistanceResult()))
                if distance == 0:
                    touching.add((first, second))
                if (first, second) in watched:
                    itself = min(itself, distance)
        row.update(fcl_itself=itself, fcl_table=lowest, fcl_touching=sorted(touching))
    with open(target, "w", encoding="utf-8") as file:
        json.dump(ours, file)


main()
