"""Other people's demonstrations become recordings of the cell `imported` (CONTRACT, section 4).

yaml_import takes the folders of matiov/learn-BTs-from-demo. bag_import takes a rosbag2: bag reads it (the one home of
`rosbags`), transforms composes chains of tf2, grippers tells open from closed. Calls go that way alone.
"""
