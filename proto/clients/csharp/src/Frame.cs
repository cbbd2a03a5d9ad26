using System;
using Pliant.V1;

namespace Pliant
{
    /// <summary>A solved vertex buffer.</summary>
    public sealed class Frame
    {
        /// <summary>The pose that it answers.</summary>
        public ulong Seq { get; internal set; }

        /// <summary>The session's revision after it.</summary>
        public ulong Revision { get; internal set; }

        /// <summary>x, y, z of every render vertex, from <see cref="Origin"/>.</summary>
        public float[] Positions { get; internal set; } = new float[0];

        /// <summary>As many normals, if <c>Options.Output.Normals</c> asks for them.</summary>
        public float[] Normals { get; internal set; } = new float[0];

        /// <summary>What is added to positions of a model far from zero; zeros for others.</summary>
        public double[] Origin { get; internal set; } = new double[3];

        /// <summary>No better frame for this pose will follow.</summary>
        public bool IsFinal { get; internal set; }

        /// <summary>Estimate of the largest displacement still missing, as a fraction of the bounding-box diagonal.</summary>
        public double MaxError { get; internal set; }

        /// <summary>Milliseconds of solving.</summary>
        public double SolveMs { get; internal set; }

        /// <summary>Poses skipped since the frame before because newer ones came.</summary>
        public uint Superseded { get; internal set; }

        /// <summary>Of a committed pose: the shape against the rest shape; null for others.</summary>
        public Quality Quality { get; internal set; }
    }

    /// <summary>Puts the parts of frames together.</summary>
    sealed class FrameAssembler
    {
        Frame frame;
        uint next;

        /// <summary>This client reads plain frames with all vertices.</summary>
        internal static void Check(Options options)
        {
            var output = options?.Output;
            if (output == null) return;
            if (output.Encoding != V1.Frame.Types.Encoding.F32 || output.HasChangedOnly || output.Tangents || output.Gradients)
                throw new PliantException(
                    StatusCode.InvalidArgument, "Options.Output: this client reads F32 positions and normals of all vertices");
        }

        /// <summary>The frame that a part completes, or null.</summary>
        internal Frame Add(V1.Frame part)
        {
            if (part.Part == 0)
            {
                frame = new Frame();
                next = 0;
            }
            if (frame == null || part.Part != next || part.Encoding != V1.Frame.Types.Encoding.F32)
                throw new PliantException(StatusCode.Internal, "a part of a frame is missing or packed");
            next++;
            if (part.Attribute == V1.Frame.Types.Attribute.Normal) frame.Normals = Joined(frame.Normals, part);
            else frame.Positions = Joined(frame.Positions, part);
            if (next < part.Parts) return null;
            var whole = frame;
            frame = null;
            whole.Seq = part.Seq;
            whole.Revision = part.Revision;
            part.Origin.CopyTo(whole.Origin, 0);
            whole.IsFinal = part.Final;
            whole.MaxError = part.MaxError;
            whole.SolveMs = part.SolveMs;
            whole.Superseded = part.Superseded;
            whole.Quality = part.Quality;
            return whole;
        }

        static float[] Joined(float[] numbers, V1.Frame part)
        {
            if (numbers.LongLength != 3L * part.FirstVertex)
                throw new PliantException(StatusCode.Internal, "the parts of a frame do not follow each other");
            // Floats of the wire and of all machines that run this are little-endian.
            var bytes = part.Data.ToByteArray();
            var joined = new float[numbers.Length + bytes.Length / sizeof(float)];
            numbers.CopyTo(joined, 0);
            Buffer.BlockCopy(bytes, 0, joined, numbers.Length * sizeof(float), bytes.Length / sizeof(float) * sizeof(float));
            return joined;
        }
    }
}
