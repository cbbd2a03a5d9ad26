using Pliant.V1;

namespace Pliant
{
    /// <summary>Handles by the regions that games and tools use most. <c>Region</c> of the schema has more.</summary>
    public static class Handles
    {
        /// <summary>Points with normal · x of at least offset.</summary>
        public static Handle HalfSpace(string id, double[] normal, double offset) =>
            new Handle { Id = id, Region = new Region { HalfSpace = new Region.Types.HalfSpace { Normal = { normal }, Offset = offset } } };

        public static Handle Sphere(string id, double[] center, double radius) =>
            new Handle { Id = id, Region = new Region { Sphere = new Region.Types.Sphere { Center = { center }, Radius = radius } } };

        public static Handle Box(string id, double[] low, double[] high) =>
            new Handle { Id = id, Region = new Region { Box = new Region.Types.Box { Min = { low }, Max = { high } } } };

        public static Handle Vertices(string id, params uint[] indices) =>
            new Handle { Id = id, Region = new Region { Vertices = new Region.Types.Vertices { Indices = { indices } } } };

        /// <summary>An entry of a pose: a displacement.</summary>
        public static Pose.Types.Entry Moved(string id, params double[] translation) =>
            new Pose.Types.Entry { Id = id, Pose = new HandlePose { Translation = { translation } } };

        /// <summary>An entry of a pose: a turn about an axis, whose length is the angle in radians.</summary>
        public static Pose.Types.Entry Turned(string id, params double[] rotationVector) =>
            new Pose.Types.Entry { Id = id, Pose = new HandlePose { RotationVector = { rotationVector } } };
    }
}
